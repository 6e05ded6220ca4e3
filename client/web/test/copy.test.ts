// SPDX-License-Identifier: MIT
// Links are copied with a clipboard, without one, and shown where neither way is open.
import { afterEach, expect, test, vi } from "vitest";
import { copied, copyLink, linkToCopy } from "../src/ui/copy";

// The browser's clipboard, and what its old command does.
function rig(clipboard: unknown, command: () => boolean) {
  const taken: string[] = [];
  const field = {
    value: "",
    style: {},
    select: () => taken.push(field.value),
    remove: () => undefined,
  };
  vi.stubGlobal("navigator", { clipboard });
  vi.stubGlobal("document", {
    createElement: () => field,
    body: { append: () => undefined },
    execCommand: command,
  });
  return taken;
}
afterEach(() => {
  vi.unstubAllGlobals();
  linkToCopy.value = "";
});

test("with a clipboard", async () => {
  const texts: string[] = [];
  rig({ writeText: (text: string) => Promise.resolve(texts.push(text)) }, () => false);
  expect(await copyLink("http://a/")).toBe(true);
  expect(texts).toEqual(["http://a/"]);
  expect(linkToCopy.value).toBe("");
});

test("without one the command copies", async () => {
  const taken = rig(undefined, () => true);
  expect(await copyLink("http://a/")).toBe(true);
  expect(taken).toEqual(["http://a/"]);
});

test("a clipboard that is not permitted", async () => {
  rig({ writeText: () => Promise.reject(new Error("not permitted")) }, () => true);
  expect(await copied("http://a/")).toBe(true);
});

test("where neither copies the link is shown", async () => {
  rig(undefined, () => false);
  expect(await copyLink("http://a/")).toBe(false);
  expect(linkToCopy.value).toBe("http://a/");
  rig(undefined, () => {
    throw new Error("no such command");
  });
  expect(await copied("http://a/")).toBe(false);
});
