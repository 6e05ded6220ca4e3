// SPDX-License-Identifier: MIT
// The order in which triangles are drawn: neighbours follow each other, so that a vertex that was just
// computed serves them, too (P. Sander, D. Nehab, J. Barczak 2007, "Fast triangle reordering for
// vertex locality and reduced overdraw", which fans about a vertex that is still in the cache).

const CACHE = 16; // vertices that a GPU keeps at least

/** The triangles [first, first + n) of three vertices each, in an order of few computed vertices. */
export function orderedTriangles(
  triangles: Uint32Array,
  first: number,
  n: number,
  nVertex: number,
): Uint32Array {
  const own = triangles.subarray(3 * first, 3 * (first + n));
  const begin = new Uint32Array(nVertex + 2);
  for (const v of own) begin[v + 2] = (begin[v + 2] ?? 0) + 1;
  for (let v = 1; v < begin.length; v++) begin[v] = (begin[v] ?? 0) + (begin[v - 1] ?? 0);
  const around = new Uint32Array(own.length); // triangles of each vertex
  own.forEach((v, i) => {
    const at = begin[v + 1] ?? 0;
    around[at] = Math.floor(i / 3);
    begin[v + 1] = at + 1;
  });
  const live = new Uint32Array(nVertex); // triangles that are not drawn yet
  for (let v = 0; v < nVertex; v++) live[v] = (begin[v + 1] ?? 0) - (begin[v] ?? 0);
  const usedAt = new Int32Array(nVertex); // when a vertex came into the cache last
  const done = new Uint8Array(n);
  const out = new Uint32Array(own.length);
  const earlier: number[] = []; // vertices to go back to
  let [time, filled, next] = [CACHE + 1, 0, 0];

  const anyLeft = (): number => {
    for (let v = earlier.pop(); v !== undefined; v = earlier.pop()) if (live[v]) return v;
    while (next < nVertex && !live[next]) next++;
    return next < nVertex ? next : -1;
  };
  // The centre of the next fan: of the last fan's vertices the one that has been in the cache for
  // longest, if its remaining triangles can be drawn before it leaves. Else any with triangles left.
  const best = (ring: readonly number[]): number => {
    let [found, most] = [-1, -1];
    for (const v of ring) {
      if (!live[v]) continue;
      const age = time - (usedAt[v] ?? 0);
      const rank = age + 2 * (live[v] ?? 0) <= CACHE ? age : 0;
      if (rank > most) [found, most] = [v, rank];
    }
    return found < 0 ? anyLeft() : found;
  };
  for (let fan = anyLeft(); fan >= 0; ) {
    const ring: number[] = [];
    for (let i = begin[fan] ?? 0; i < (begin[fan + 1] ?? 0); i++) {
      const t = around[i] ?? 0;
      if (done[t]) continue;
      done[t] = 1;
      for (let k = 0; k < 3; k++) {
        const v = own[3 * t + k] ?? 0;
        out[filled++] = v;
        ring.push(v);
        earlier.push(v);
        live[v] = (live[v] ?? 0) - 1;
        if (time - (usedAt[v] ?? 0) > CACHE) usedAt[v] = time++;
      }
    }
    fan = best(ring);
  }
  return out;
}
