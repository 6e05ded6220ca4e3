// SPDX-License-Identifier: MIT
// Fewer triangles of the same vertices, for frames of half the resolution (frame-quality.ts): of the
// vertices that lie in one cell of a grid one stands for all, and triangles that lose an area go.

/** Cells along the longest side of the box. */
const CELLS = 80;

/** The vertex that stands for each one: the first of its cell whose normal turns the same way. */
export function standIns(positions: Float32Array, normals: Float32Array): Uint32Array {
  const n = positions.length / 3;
  const low = [Infinity, Infinity, Infinity];
  let longest = 0;
  for (let k = 0; k < 3; k++) {
    let high = -Infinity;
    for (let v = 0; v < n; v++) {
      const x = positions[3 * v + k] ?? 0;
      low[k] = Math.min(low[k] ?? 0, x);
      high = Math.max(high, x);
    }
    longest = Math.max(longest, high - (low[k] ?? 0));
  }
  const scale = longest > 0 ? CELLS / longest : 0;
  const first = new Map<number, number>();
  const out = new Uint32Array(n);
  for (let v = 0; v < n; v++) {
    let [cell, side] = [0, 0];
    for (let k = 0; k < 3; k++) {
      cell =
        cell * (CELLS + 1) + Math.floor(((positions[3 * v + k] ?? 0) - (low[k] ?? 0)) * scale);
      // The two sides of a thin part are not joined.
      side = 2 * side + ((normals[3 * v + k] ?? 0) < 0 ? 1 : 0);
    }
    const key = 8 * cell + side;
    const old = first.get(key);
    if (old === undefined) first.set(key, v);
    out[v] = old ?? v;
  }
  return out;
}

/** The triangles [first, first + n) that keep an area. */
export function coarseTriangles(
  triangles: Uint32Array,
  first: number,
  n: number,
  stands: Uint32Array,
): Uint32Array {
  const out = new Uint32Array(3 * n);
  let filled = 0;
  for (let t = first; t < first + n; t++) {
    const [a = 0, b = 0, c = 0] = [0, 1, 2].map((k) => stands[triangles[3 * t + k] ?? 0]);
    if (a === b || b === c || a === c) continue;
    out.set([a, b, c], filled);
    filled += 3;
  }
  return out.slice(0, filled);
}
