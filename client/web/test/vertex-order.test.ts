// SPDX-License-Identifier: MIT
import { describe, expect, it } from "vitest";
import { orderedTriangles } from "../src/scene/vertex-order";

// Vertices that a cache of 16, first in, first out, computes for a triangle.
function computed(triangles: Uint32Array): number {
  const cache: number[] = [];
  let n = 0;
  for (const v of triangles) {
    if (cache.includes(v)) continue;
    n++;
    cache.push(v);
    if (cache.length > 16) cache.shift();
  }
  return (3 * n) / triangles.length;
}
// A grid of n x n squares whose triangles come in no order.
function shuffledGrid(n: number): Uint32Array {
  const all: [number, number, number][] = [];
  for (let y = 0; y < n; y++)
    for (let x = 0; x < n; x++) {
      const a = y * (n + 1) + x;
      all.push([a, a + 1, a + n + 1], [a + 1, a + n + 2, a + n + 1]);
    }
  const key = (t: readonly number[]) => Math.sin(12.9898 * (t[0] ?? 0) + 78.233 * (t[2] ?? 0));
  return Uint32Array.from(all.sort((p, q) => key(p) - key(q)).flat());
}
// Each triangle with its corners in their order, from the least on.
const sorted = (triangles: Uint32Array): string[] =>
  Array.from({ length: triangles.length / 3 }, (_, t) => {
    const [a = 0, b = 0, c = 0] = triangles.subarray(3 * t, 3 * t + 3);
    return (a < b && a < c ? [a, b, c] : b < c ? [b, c, a] : [c, a, b]).join();
  }).sort();

describe("orderedTriangles", () => {
  const grid = shuffledGrid(40);
  const ordered = orderedTriangles(grid, 0, grid.length / 3, 41 * 41);
  it("keeps the triangles and their sides", () => {
    expect(sorted(ordered)).toEqual(sorted(grid));
  });
  it("computes few vertices twice", () => {
    expect(computed(grid)).toBeGreaterThan(2.5);
    expect(computed(ordered)).toBeLessThan(0.8);
  });
  it("takes a range, and none", () => {
    const part = orderedTriangles(grid, 100, 50, 41 * 41);
    expect(sorted(part)).toEqual(sorted(grid.slice(300, 450)));
    expect(orderedTriangles(grid, 7, 0, 41 * 41)).toHaveLength(0);
  });
});
