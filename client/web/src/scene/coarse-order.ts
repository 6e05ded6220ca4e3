// SPDX-License-Identifier: MIT
// Colours of a coarser vertex set, as a slow link has them, made into colours of all vertices
// (PROTOCOL.md, GEOMETRY): a vertex that was left out is the mean of its two parents.
import {
  ColorFormat,
  GeometryAnswerSchema,
  GeometryRequestSchema,
  type ColorsAnswer,
  type GeometryAnswer,
} from "../gen/relight_pb";
import type { Client } from "../protocol/client";
import { halves, Type, words } from "../protocol/frame";
import { DataUtils } from "three";

export interface CoarseOrder {
  hash: bigint;
  nVertex: number;
  nRoot: number;
  /** [nVertex] the vertex at each position. */
  vertex: Uint32Array;
  /** [nVertex][2] positions of its parents, smaller than its own from nRoot on. */
  parents: Uint32Array;
}

/** Throws where a vertex does not come once, or before its parents. */
export function orderOf(answer: GeometryAnswer, payload: Uint8Array): CoarseOrder {
  const n = answer.nVertex;
  const nRoot = answer.nCoarseRoot;
  const vertex = words(payload, 0, n);
  const parents = words(payload, Number(answer.coarseParentsOffset), 2 * n);
  const seen = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    const v = vertex[i] ?? n;
    const late = i >= nRoot && Math.max(parents[2 * i] ?? n, parents[2 * i + 1] ?? n) >= i;
    if (v >= n || seen[v] || late) throw new Error("the coarse order contradicts itself");
    seen[v] = 1;
  }
  return { hash: answer.coarseOrder, nVertex: n, nRoot, vertex, parents };
}

export async function fetchOrder(client: Client, model: string): Promise<CoarseOrder> {
  const { message, payload } = await client.request(
    Type.Geometry,
    GeometryRequestSchema,
    { model, coarse: true },
    GeometryAnswerSchema,
  );
  return orderOf(message, payload);
}

function decoded(answer: ColorsAnswer, payload: Uint8Array, n: number): Float32Array {
  const out = new Float32Array(3 * n);
  if (answer.format === ColorFormat.COLOR_F16) {
    halves(payload, 0, 3 * n).forEach((half, i) => (out[i] = DataUtils.fromHalfFloat(half)));
    return out;
  }
  words(payload, 0, n).forEach((word, i) => {
    const scale = 2 ** ((word >>> 27) - 24);
    for (let c = 0; c < 3; c++) out[3 * i + c] = ((word >>> (9 * c)) & 511) * scale;
  });
  return out;
}

/** [parts][nVertex][3] linear RGB of all vertices; throws where the answer is of another order. */
export function expanded(
  order: CoarseOrder,
  answer: ColorsAnswer,
  payload: Uint8Array,
): Float32Array {
  const { nVertex, nRoot, vertex, parents } = order;
  const sent = answer.nCoarse;
  const parts = Math.max(1, answer.nPart);
  if (answer.coarseOrder !== order.hash || sent < nRoot || sent > nVertex)
    throw new Error("colours of another coarse order");
  const some = decoded(answer, payload, sent * parts);
  const out = new Float32Array(3 * nVertex * parts);
  const at = new Float32Array(3 * nVertex); // one part, by position
  for (let part = 0; part < parts; part++) {
    at.set(some.subarray(3 * sent * part, 3 * sent * (part + 1)));
    for (let i = sent; i < nVertex; i++) {
      const a = 3 * (parents[2 * i] ?? 0);
      const b = 3 * (parents[2 * i + 1] ?? 0);
      for (let c = 0; c < 3; c++) at[3 * i + c] = 0.5 * ((at[a + c] ?? 0) + (at[b + c] ?? 0));
    }
    for (let i = 0; i < nVertex; i++)
      for (let c = 0; c < 3; c++)
        out[3 * (part * nVertex + (vertex[i] ?? 0)) + c] = at[3 * i + c] ?? 0;
  }
  return out;
}
