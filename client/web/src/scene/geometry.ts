// SPDX-License-Identifier: MIT
// GEOMETRY's answer as a mesh: positions, normals, triangles, and runs of triangles of one surface.
import type { Block, GeometryAnswer, Surface } from "../gen/relight_pb";
import { bytes, floats, words } from "../protocol/frame";
import { frameOf, type Frame } from "./camera";

export interface Part {
  /** Of GEOMETRY. */
  block: number;
  /** Index of the model's object. */
  object: number;
  firstIndex: number;
  nIndex: number;
  opaque: boolean;
  surface: Surface | null;
}
export interface Mesh {
  nVertex: number;
  positions: Float32Array;
  normals: Float32Array;
  triangles: Uint32Array;
  /** Sets of texture coordinates, [nVertex][2] each. */
  uv: Float32Array[];
  /** [nTriangle][3][2] in place of set 0, where an OBJ has seams. */
  cornerUv: Float32Array | null;
  tint: Float32Array | null;
  /** Spherical harmonics of the sky that the model hides from a vertex (PROTOCOL, INFO, LIST,
   * GEOMETRY): [nVertex][16] in steps of 4/127; null: not known. */
  blocked: Int8Array | null;
  parts: Part[];
  frame: Frame;
  mmPerUnit: number;
  split: number;
  generation: bigint;
  /** GeometryAnswer.mesh_hash; empty: not known. */
  hash: string;
  /** A variant's opaque albedo is not the one that was baked. */
  gained: boolean;
}

function partsOf(answer: GeometryAnswer): Part[] {
  const blocks: [Block, number][] = answer.blocks
    .map((block, i): [Block, number] => [block, i])
    .filter(([block]) => block.nTriangle > 0);
  if (!blocks.length)
    return [
      {
        block: 0,
        object: 0,
        firstIndex: 0,
        nIndex: 3 * answer.nTriangle,
        opaque: false,
        surface: null,
      },
    ];
  return blocks.map(([block, i]) => ({
    block: i,
    object: block.object,
    firstIndex: 3 * block.triangleBegin,
    nIndex: 3 * block.nTriangle,
    opaque: !block.translucent,
    surface: answer.surfaces[block.surfaceIndex] ?? null,
  }));
}

/** Positions are in the model's own units (own_units of the request). */
export function meshOf(answer: GeometryAnswer, payload: Uint8Array): Mesh {
  const n = answer.nVertex;
  const positions = floats(payload, Number(answer.positionsOffset), 3 * n);
  const translucent = new Uint8Array(n);
  for (const block of answer.blocks)
    if (block.translucent)
      translucent.fill(1, block.vertexBegin, block.vertexBegin + block.nVertex);
  const all = !translucent.includes(1);
  return {
    nVertex: n,
    positions,
    normals: floats(payload, Number(answer.normalsOffset), 3 * n),
    triangles: words(payload, Number(answer.trianglesOffset), 3 * answer.nTriangle),
    uv: Array.from({ length: answer.nUv }, (_, set) =>
      floats(payload, Number(answer.uvOffset) + 8 * n * set, 2 * n),
    ),
    cornerUv: answer.cornerUvOffset
      ? floats(payload, Number(answer.cornerUvOffset), 6 * answer.nTriangle)
      : null,
    tint: answer.colorOffset ? floats(payload, Number(answer.colorOffset), 4 * n) : null,
    blocked: answer.blockedOffset ? bytes(payload, Number(answer.blockedOffset), 16 * n) : null,
    parts: partsOf(answer),
    frame: frameOf(positions, (v) => all || translucent[v] === 1),
    mmPerUnit: answer.mmPerUnit,
    split: answer.textureSplit,
    generation: answer.generation,
    hash: answer.meshHash,
    gained: answer.blocks.some(
      ({ gain }) => gain && (gain.x !== 1 || gain.y !== 1 || gain.z !== 1),
    ),
  };
}

/** The vertices of a mesh for WebGL, which has one coordinate a vertex and set: those at seams are
 * several, each with its own. */
export interface Corners {
  triangles: Uint32Array;
  /** Vertex of the mesh. */
  source: Uint32Array;
  /** Set 0. */
  uv: Float32Array;
}
export function cornersOf(mesh: Pick<Mesh, "triangles" | "cornerUv">): Corners | null {
  const { triangles, cornerUv } = mesh;
  if (!cornerUv) return null;
  const source: number[] = [];
  const uv: number[] = [];
  const known = new Map<string, number>();
  const out = triangles.map((vertex, corner) => {
    const [u = 0, v = 0] = cornerUv.subarray(2 * corner, 2 * corner + 2);
    const key = `${vertex},${u},${v}`;
    const old = known.get(key);
    if (old !== undefined) return old;
    known.set(key, source.length);
    uv.push(u, v);
    return source.push(vertex) - 1;
  });
  return { triangles: out, source: Uint32Array.from(source), uv: Float32Array.from(uv) };
}

/** Rows of `width` numbers, one for each vertex of `source`. */
export function rowsAt<T extends Float32Array | Int8Array | Uint16Array | Uint32Array>(
  values: T,
  width: number,
  source: Uint32Array,
): T {
  const out = new (values.constructor as new (n: number) => T)(source.length * width);
  source.forEach((vertex, i) => {
    out.set(values.subarray(vertex * width, (vertex + 1) * width), i * width);
  });
  return out;
}
