// SPDX-License-Identifier: MIT
import { describe, expect, it } from "vitest";
import { FrameQuality, type Quality } from "../src/scene/frame-quality";

// A GPU that takes so long for frames of each quality: the quality of each of `n` frames of a hand
// that moves, 60 a second at most.
function qualities(tookMs: readonly [number, number, number], n: number): Quality[] {
  const q = new FrameQuality();
  const seen: Quality[] = [];
  for (let now = 0; seen.length < n; now += Math.max(17, tookMs[seen.at(-1) ?? 0])) {
    seen.push(q.moving);
    q.drawn(q.moving, tookMs[q.moving], now);
  }
  return seen;
}

describe("FrameQuality", () => {
  it("stays in full on a fast GPU", () => {
    expect(qualities([16, 16, 16], 200).every((one) => one === 0)).toBe(true);
    expect(qualities([35, 20, 16], 200).every((one) => one === 0)).toBe(true);
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
  it("learns nothing from a picture that rests", () => {
    const q = new FrameQuality();
    q.drawn(0, 90, 0);
    q.drawn(0, 900, 100);
    expect(q.moving).toBe(1);
  });
});
