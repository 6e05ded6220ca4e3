// SPDX-License-Identifier: MIT
// Arrow keys in a group of tabs or radio buttons.
import { expect, test } from "vitest";
import { arrowKeys } from "../src/ui/controls";

type Pressed = Parameters<typeof arrowKeys>[0];

// Presses a key in a group of three; what was focused, what was clicked, and whether the key is spent.
function press(key: string, at: number, more: Partial<KeyboardEvent> = {}) {
  const done: string[] = [];
  const all = [0, 1, 2].map((i) => ({
    focus: () => done.push(`focus ${i}`),
    click: () => done.push(`click ${i}`),
  }));
  arrowKeys({
    key,
    target: all[at] ?? null,
    currentTarget: { querySelectorAll: () => all },
    preventDefault: () => done.push("spent"),
    ...more,
  } as unknown as Pressed);
  return done;
}

test("they choose the next and the previous one, round the ends", () => {
  expect(press("ArrowRight", 0)).toEqual(["spent", "focus 1", "click 1"]);
  expect(press("ArrowDown", 2)).toEqual(["spent", "focus 0", "click 0"]);
  expect(press("ArrowLeft", 0)).toEqual(["spent", "focus 2", "click 2"]);
  expect(press("ArrowUp", 2)).toEqual(["spent", "focus 1", "click 1"]);
});

test("other keys, keys with Ctrl and keys of another field do nothing", () => {
  expect(press("Enter", 0)).toEqual([]);
  expect(press("ArrowRight", 0, { ctrlKey: true })).toEqual([]);
  expect(press("ArrowRight", 7)).toEqual([]);
});
