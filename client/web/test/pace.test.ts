// SPDX-License-Identifier: MIT
import { describe, expect, test } from "vitest";
import { LEVELS, MOST_OUTSTANDING, Pace } from "../src/scene/pace";

interface Link {
  bytesPerMs: number;
  roundTripMs: number;
}
// A hand that moves all the time on a link that carries one frame after another, in simulated
// time. bytes: of a frame by level.
function drag(link: Link, bytes: readonly number[], ms: number) {
  const pace = new Pace();
  const open: { sentAt: number; level: number; comesAt: number }[] = [];
  const frames: { at: number; delay: number; level: number }[] = [];
  let free = 0; // when the link has carried what is on it
  let most = 0;
  for (let now = 0; now < ms; now++) {
    while (open[0] && open[0].comesAt <= now) {
      const { sentAt, level } = open.shift() ?? { sentAt: 0, level: 0 };
      pace.answered(now - sentAt, level);
      frames.push({ at: now, delay: now - sentAt, level });
    }
    if (open.length >= pace.outstanding) continue;
    const arrives = now + link.roundTripMs / 2;
    free = Math.max(free, arrives) + (bytes[pace.level] ?? 0) / link.bytesPerMs;
    open.push({ sentAt: now, level: pace.level, comesAt: free + link.roundTripMs / 2 });
    most = Math.max(most, open.length);
  }
  const late = frames.filter(({ at }) => at > ms / 3);
  return {
    most,
    level: pace.level,
    rate: (late.length * 1000) / (ms - ms / 3),
    delay: late.reduce((sum, { delay }) => sum + delay, 0) / late.length,
    coarse: late.filter(({ level }) => level > 0).length / late.length,
  };
}

describe("a hand on a link of 5 Mbit/s with 80 ms", () => {
  const link = { bytesPerMs: 625, roundTripMs: 80 };
  // Bytes of coefficients: a bunny of 35,000 vertices, and models three and six times as large.
  for (const [name, full, coarse] of [
    ["bunny", 34_200, 16_400],
    ["large", 110_000, 37_000],
    ["larger", 220_000, 74_000],
  ] as const)
    test(name, () => {
      const found = drag(link, [full, coarse, coarse / 2], 30_000);
      expect(found.rate).toBeGreaterThanOrEqual(15);
      expect(found.delay).toBeLessThanOrEqual(250);
      expect(found.most).toBeLessThanOrEqual(MOST_OUTSTANDING);
      if (full > 50_000) expect(found.coarse).toBeGreaterThan(0.8);
      else expect(found.level).toBe(0);
    });
});

test("on a near link one state is outstanding, and frames are whole", () => {
  const found = drag({ bytesPerMs: 100_000, roundTripMs: 2 }, [40_000, 12_000, 6_000], 2_000);
  expect(found).toMatchObject({ most: 1, level: 0, coarse: 0 });
});

test("a link that has become wide again carries whole frames again", () => {
  const pace = new Pace();
  for (let i = 0; i < 3; i++) pace.answered(400, 0);
  expect(pace.level).toBe(1);
  for (let i = 0; i < 100; i++) pace.answered(40, pace.level);
  expect(pace.level).toBe(0);
  expect(pace.outstanding).toBe(1);
});

test("a hand that begins to move measures the link anew", () => {
  const pace = new Pace();
  for (let i = 0; i < 3; i++) pace.answered(30, 0);
  expect(pace.outstanding).toBe(1);
  pace.began();
  for (let i = 0; i < 3; i++) pace.answered(160, 0);
  expect(pace.outstanding).toBe(3);
});

test("answers of an earlier level say nothing; colours have one level", () => {
  const pace = new Pace();
  for (let i = 0; i < 3; i++) pace.answered(400, 0);
  for (let i = 0; i < 9; i++) pace.answered(900, 0);
  expect(pace.level).toBe(1);
  const colours = new Pace(1);
  for (let i = 0; i < 30; i++) colours.answered(900, 0);
  expect(colours.level).toBe(0);
  expect(LEVELS[0]).toMatchObject({ rank: 0, side: 1 });
});
