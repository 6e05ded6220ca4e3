// SPDX-License-Identifier: MIT
// A mesh as the attributes and the index that three.js draws.
import {
  BufferAttribute,
  BufferGeometry,
  InterleavedBuffer,
  InterleavedBufferAttribute,
} from "three";
import { cornersOf, rowsAt, type Mesh } from "./geometry";
import { orderedTriangles } from "./vertex-order";

/** Parts times vertices up to which triangles are ordered. */
const MOST_ORDERED = 20e6;

// The triangles of each part in the order in which they are drawn. Of many parts of many vertices
// it stays that of the file: the search takes memory of all vertices for each part.
function drawnOrder(mesh: Mesh, triangles: Uint32Array): Uint32Array {
  if (mesh.parts.length * mesh.nVertex > MOST_ORDERED) return triangles;
  const out = triangles.slice();
  const nVertex = triangles.reduce((most, v) => Math.max(most, v + 1), 0);
  for (const { firstIndex, nIndex } of mesh.parts)
    out.set(orderedTriangles(triangles, firstIndex / 3, nIndex / 3, nVertex), firstIndex);
  return out;
}

/** Attributes of all vertices, and the index. */
export function attributesOf(mesh: Mesh): BufferGeometry {
  const all = new BufferGeometry();
  const corners = cornersOf(mesh);
  const at = <T extends Float32Array | Int8Array>(values: T, width: number) =>
    corners ? rowsAt(values, width, corners.source) : values;
  all.setAttribute("position", new BufferAttribute(at(mesh.positions, 3), 3));
  all.setAttribute("normal", new BufferAttribute(at(mesh.normals, 3), 3));
  mesh.uv.forEach((uv, set) => {
    const own = set === 0 && corners ? corners.uv : at(uv, 2);
    all.setAttribute(`uv${set}`, new BufferAttribute(own, 2));
  });
  if (corners) all.setAttribute("source", new BufferAttribute(corners.source, 1));
  if (mesh.tint) all.setAttribute("tint", new BufferAttribute(at(mesh.tint, 4), 4));
  if (mesh.blocked) {
    const sky = new InterleavedBuffer(at(mesh.blocked, 16), 16);
    for (let i = 0; i < 4; i++)
      all.setAttribute(`blocked${i}`, new InterleavedBufferAttribute(sky, 4, 4 * i));
  }
  all.setIndex(new BufferAttribute(drawnOrder(mesh, corners?.triangles ?? mesh.triangles), 1));
  return all;
}
