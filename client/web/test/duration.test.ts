// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { duration } from "../src/ui/duration";

test("a time that is left is in seconds, minutes or hours", () => {
  expect([0.2, 45, 99].map(duration)).toEqual(["1 s", "45 s", "99 s"]);
  expect([99.6, 720, 3540].map(duration)).toEqual(["2 min", "12 min", "59 min"]);
  expect([3590, 3643, 5000, 90000].map(duration)).toEqual([
    "1 h",
    "1 h 1 min",
    "1 h 23 min",
    "25 h",
  ]);
});
