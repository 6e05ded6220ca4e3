// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import "./fake-browser";

const { takeChosen } = await import("../src/ui/file-input");

test("chosen files are kept when the input is emptied, as browsers empty its list", () => {
  const files = [new File(["v 0 0 0"], "a.obj"), new File([""], "b.hdr")];
  const input = {
    files,
    get value() {
      return files.length ? "C:\\fakepath\\a.obj" : "";
    },
    set value(text: string) {
      if (!text) files.length = 0;
    },
  };
  expect(takeChosen(input).map(({ name }) => name)).toEqual(["a.obj", "b.hdr"]);
  expect(input.value).toBe("");
  expect(takeChosen({ files: null, value: "" })).toEqual([]);
});
