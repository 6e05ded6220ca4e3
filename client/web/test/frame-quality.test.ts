// SPDX-License-Identifier: MIT
import { describe, expect, it } from "vitest";
import { FrameQuality, type Quality } from "../src/scene/frame-quality";

// A GPU that takes so long for frames of each quality: the quality of each of `n` frames of a hand
// that moves, on a display with a frame each intervalMs.
function qualities(
  tookMs: readonly [number, number, number],
  n: number,
  intervalMs = 17,
): Quality[] {
  const q = new FrameQuality();
  const seen: Quality[] = [];
  for (let now = 0; seen.length < n; ) {
    const frames = Math.ceil(tookMs[q.moving] / intervalMs);
    seen.push(q.moving);
    now += frames * intervalMs;
    q.drawn(q.moving, frames * intervalMs, frames === 1, now);
  }
  return seen;
}

describe("FrameQuality", () => {
  it("stays in full on a fast GPU", () => {
    expect(qualities([16, 16, 16], 200).every((one) => one === 0)).toBe(true);
    expect(qualities([33, 20, 16], 200).every((one) => one === 0)).toBe(true);
  });
  it("goes down as far as it has to", () => {
    expect(qualities([90, 30, 20], 5)).toEqual([0, 1, 1, 1, 1]);
    expect(qualities([400, 200, 100], 5)).toEqual([0, 1, 2, 2, 2]);
  });
  it("tries a finer one ever more seldom", () => {
    const seen = qualities([90, 17, 17], 6000);
    const tries = seen.filter((one) => one === 0).length;
    expect(tries).toBeGreaterThan(2);
    expect(tries).toBeLessThan(10);
  });
  it("comes back after one slow frame, on a slow display, too", () => {
    for (const intervalMs of [8, 17, 33]) {
      const q = new FrameQuality();
      q.drawn(0, 900, false, 0); // a shader was compiled
      for (let now = intervalMs; now < 2500; now += intervalMs)
        q.drawn(q.moving, intervalMs, true, now);
      expect(q.moving).toBe(0);
    }
  });
  it("asks for more coefficients again where frames have become faster", () => {
    const q = new FrameQuality();
    q.drawn(0, 200, false, 0);
    q.drawn(1, 200, false, 200);
    q.drawn(2, 100, false, 400);
    expect(q.leastLevel).toBe(2);
    q.drawn(2, 70, false, 500);
    expect(q.leastLevel).toBe(2);
    for (let i = 0; i < 9; i++) q.drawn(2, 50, false, 570 + 50 * i);
    expect(q.leastLevel).toBe(2);
    q.drawn(2, 50, false, 1020);
    expect([q.moving, q.leastLevel]).toEqual([2, 1]);
  });
  it("learns nothing from a picture that rests", () => {
    const q = new FrameQuality();
    q.drawn(0, 90, false, 0);
    q.drawn(0, 900, false, 100);
    expect(q.moving).toBe(1);
  });
});
