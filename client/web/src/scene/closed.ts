// SPDX-License-Identifier: MIT
// Whether a surface is closed and its triangles turn outwards: then no face is seen from behind, by an
// eye outside.

// Two vertices' number, the same for (a, b) and (b, a); of different pairs almost surely another.
function pairHash(a: number, b: number, seed: number): number {
  let h = Math.imul(Math.min(a, b) ^ seed, 0x9e3779b1);
  h = Math.imul(h ^ (h >>> 15) ^ Math.max(a, b), 0x85ebca77);
  h = Math.imul(h ^ (h >>> 13), 0xc2b2ae3d);
  return h ^ (h >>> 16);
}

/** Each edge is run through as often one way as the other: the sums of two hashes of the edges,
 * negative for one of the two ways, are 0. */
function edgesMatch(triangles: Uint32Array): boolean {
  let first = 0;
  let second = 0;
  for (let t = 0; t + 2 < triangles.length; t += 3)
    for (let k = 0; k < 3; k++) {
      const a = triangles[t + k] ?? 0;
      const b = triangles[t + ((k + 1) % 3)] ?? 0;
      const sign = a < b ? 1 : -1;
      first = (first + sign * pairHash(a, b, 0)) | 0;
      second = (second + sign * pairHash(a, b, 0x51ed270b)) | 0;
    }
  return first === 0 && second === 0;
}

/** The piece that each vertex belongs to: vertices that triangles join. */
function piecesOf(nVertex: number, triangles: Uint32Array): Uint32Array {
  const up = Uint32Array.from({ length: nVertex }, (_, i) => i);
  const find = (v: number): number => {
    while (up[v] !== v) v = up[v] = up[up[v] ?? 0] ?? 0;
    return v;
  };
  for (let t = 0; t + 2 < triangles.length; t += 3) {
    const root = find(triangles[t] ?? 0);
    up[find(triangles[t + 1] ?? 0)] = root;
    up[find(triangles[t + 2] ?? 0)] = root;
  }
  return up.map((_, v) => find(v));
}

/** Every piece is closed and has a volume above 0. positions [n][3], triangles [m][3]. */
export function isClosed(positions: Float32Array, triangles: Uint32Array): boolean {
  if (!triangles.length || !edgesMatch(triangles)) return false;
  const piece = piecesOf(positions.length / 3, triangles);
  const volume = new Map<number, number>();
  const at = (corner: number, axis: number) => positions[3 * corner + axis] ?? 0;
  for (let t = 0; t + 2 < triangles.length; t += 3) {
    const [a = 0, b = 0, c = 0] = triangles.subarray(t, t + 3);
    const six =
      at(a, 0) * (at(b, 1) * at(c, 2) - at(b, 2) * at(c, 1)) +
      at(a, 1) * (at(b, 2) * at(c, 0) - at(b, 0) * at(c, 2)) +
      at(a, 2) * (at(b, 0) * at(c, 1) - at(b, 1) * at(c, 0));
    const own = piece[a] ?? 0;
    volume.set(own, (volume.get(own) ?? 0) + six);
  }
  return [...volume.values()].every((six) => six > 0);
}

/** The largest distance of a vertex from a point. */
export function reachOf(
  positions: Float32Array,
  [x, y, z]: readonly [number, number, number],
): number {
  let most = 0;
  for (let i = 0; i + 2 < positions.length; i += 3) {
    const u = (positions[i] ?? 0) - x;
    const v = (positions[i + 1] ?? 0) - y;
    const w = (positions[i + 2] ?? 0) - z;
    most = Math.max(most, u * u + v * v + w * w);
  }
  return Math.sqrt(most);
}
