// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { brightened, hexOf, strengthOf, tinted } from "../src/state/lamp-gain";
import type { Vec3 } from "../src/scene/camera";

test("a colour changes no strength, a strength no colour", () => {
  const red = tinted([4, 4, 4], "#ff8000");
  expect(strengthOf(red)).toBeCloseTo(2, 6);
  expect(hexOf(red)).toBe("#ff8000");
  const weak = brightened(red, -3);
  expect(strengthOf(weak)).toBeCloseTo(-3, 6);
  expect(hexOf(weak)).toBe("#ff8000");
});

test("black keeps colour and strength: a hand that passes it comes back to both", () => {
  const red: Vec3 = [4, 0, 0];
  expect(hexOf(tinted(red, "#000000"))).toBe("#ff0000");
  expect(hexOf(tinted(tinted(red, "#400000"), "#000000"))).toBe("#ff0000");
  expect(strengthOf(tinted(tinted(red, "#000000"), "#00ff00"))).toBeCloseTo(2, 6);
});

test("a lamp that is dark already gets light again", () => {
  const dark: Vec3 = [0, 0, 0];
  expect(tinted(dark, "#00ff00")).toEqual([0, 1, 0]);
  expect(brightened(dark, 1)).toEqual([2, 2, 2]);
});
