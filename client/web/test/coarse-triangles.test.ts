// SPDX-License-Identifier: MIT
import { describe, expect, it } from "vitest";
import { coarseTriangles, standIns } from "../src/scene/coarse-triangles";

// A flat sheet of n x n squares, one unit along a side, that looks along +z.
function sheet(n: number) {
  const positions: number[] = [];
  const triangles: number[] = [];
  for (let y = 0; y <= n; y++) for (let x = 0; x <= n; x++) positions.push(x / n, y / n, 0);
  for (let y = 0; y < n; y++)
    for (let x = 0; x < n; x++) {
      const a = y * (n + 1) + x;
      triangles.push(a, a + 1, a + n + 1, a + 1, a + n + 2, a + n + 1);
    }
  return { positions: Float32Array.from(positions), triangles: Uint32Array.from(triangles) };
}
const upwards = (n: number) =>
  Float32Array.from({ length: 3 * n }, (_, i) => Number(i % 3 === 2));
function area(positions: Float32Array, triangles: Uint32Array): number {
  let sum = 0;
  const at = (v: number, k: number) => positions[3 * (triangles[v] ?? 0) + k] ?? 0;
  for (let t = 0; t < triangles.length; t += 3)
    sum +=
      ((at(t + 1, 0) - at(t, 0)) * (at(t + 2, 1) - at(t, 1)) -
        (at(t + 1, 1) - at(t, 1)) * (at(t + 2, 0) - at(t, 0))) /
      2;
  return sum;
}

describe("coarseTriangles", () => {
  const { positions, triangles } = sheet(200);
  const stands = standIns(positions, upwards(positions.length / 3));
  it("has fewer triangles of the same surface", () => {
    const coarse = coarseTriangles(triangles, 0, triangles.length / 3, stands);
    expect(coarse.length).toBeLessThan(0.25 * triangles.length);
    expect(area(positions, coarse)).toBeGreaterThan(0.96);
    expect(area(positions, coarse)).toBeLessThanOrEqual(1.0001);
  });
  it("keeps two sides of a thin part apart", () => {
    const both = Float32Array.from([...positions, ...positions]);
    const up = upwards(positions.length / 3);
    const apart = standIns(both, Float32Array.from([...up, ...up.map((x) => -x)]));
    const n = positions.length / 3;
    expect(Math.min(...apart.subarray(n))).toBeGreaterThanOrEqual(n);
  });
  it("keeps what is coarse already", () => {
    const few = sheet(10);
    const own = standIns(few.positions, upwards(121));
    expect(coarseTriangles(few.triangles, 0, 200, own)).toEqual(few.triangles);
    expect(coarseTriangles(few.triangles, 3, 2, own)).toEqual(few.triangles.slice(9, 15));
  });
});
