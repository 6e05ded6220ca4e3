// SPDX-License-Identifier: MIT
// One triangle that covers the whole target, for passes over its pixels.
import { BufferAttribute, BufferGeometry, Mesh, type RawShaderMaterial } from "three";

/** Its corners are in clip space: the material's vertex shader passes `position` on. */
export function screenTriangle(material: RawShaderMaterial): Mesh {
  const geometry = new BufferGeometry();
  const corners = new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]);
  geometry.setAttribute("position", new BufferAttribute(corners, 3));
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}
