// SPDX-License-Identifier: MIT
import { describe, expect, it } from "vitest";
import { isClosed, reachOf } from "../src/scene/closed";

const corners = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1];
const outwards = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3];
const closed = (positions: number[], triangles: number[]) =>
  isClosed(Float32Array.from(positions), Uint32Array.from(triangles));
const moved = corners.map((x, i) => x + (i % 3 ? 0 : 5));
const shifted = outwards.map((v) => v + 4);
const inwards = (triangles: number[]) => [...triangles].reverse();

describe("isClosed", () => {
  it("takes closed pieces whose triangles turn outwards", () => {
    expect(closed(corners, outwards)).toBe(true);
    expect(closed([...corners, ...moved], [...outwards, ...shifted])).toBe(true);
  });
  it("does not take a surface with a hole, nor one with a triangle turned", () => {
    expect(closed(corners, outwards.slice(3))).toBe(false);
    expect(closed(corners, [...inwards(outwards.slice(0, 3)), ...outwards.slice(3)])).toBe(
      false,
    );
    expect(closed(corners, [])).toBe(false);
  });
  it("does not take a piece that is inside out, however small", () => {
    expect(closed(corners, inwards(outwards))).toBe(false);
    const small = moved.map((x) => x * 0.1);
    expect(closed([...corners, ...small], [...outwards, ...inwards(shifted)])).toBe(false);
  });
});

describe("reachOf", () => {
  it("is the distance of the farthest vertex", () => {
    expect(reachOf(Float32Array.from([1, 1, 1, 4, 5, 1]), [1, 1, 1])).toBe(5);
    expect(reachOf(new Float32Array(0), [1, 1, 1])).toBe(0);
  });
});
