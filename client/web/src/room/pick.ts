// SPDX-License-Identifier: MIT
// Points of a surface on the screen, and back.
import type { Placed, Vec3 } from "../scene/camera";
import type { Mesh } from "../scene/geometry";

export interface Point {
  object: number;
  triangle: number;
  b1: number;
  b2: number;
  position: Vec3;
}

const less = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const unit = (a: Vec3): Vec3 => {
  const n = Math.hypot(...a) || 1;
  return [a[0] / n, a[1] / n, a[2] / n];
};

function axes(placed: Placed): { forward: Vec3; right: Vec3; up: Vec3; scale: number } {
  const forward = unit(less(placed.target, placed.eye));
  const right = unit(cross(forward, placed.up));
  return {
    forward,
    right,
    up: cross(right, forward),
    scale: 1 / (2 * Math.tan((placed.fovyDeg * Math.PI) / 360)),
  };
}

/** Pixels from the left and the top; null: behind the eye. */
export function project(
  placed: Placed,
  at: Vec3,
  width: number,
  height: number,
): { x: number; y: number; depth: number } | null {
  const { forward, right, up, scale } = axes(placed);
  const d = less(at, placed.eye);
  const depth = dot(d, forward);
  if (!(depth > 0)) return null;
  return {
    x: width / 2 + (dot(d, right) / depth) * scale * height,
    y: height / 2 - (dot(d, up) / depth) * scale * height,
    depth,
  };
}

/** The nearest triangle under a pixel (Möller and Trumbore 1997); null: none. */
export function pick(
  mesh: Mesh,
  placed: Placed,
  x: number,
  y: number,
  width: number,
  height: number,
): Point | null {
  const { forward, right, up, scale } = axes(placed);
  const u = (x - width / 2) / (scale * height);
  const v = (height / 2 - y) / (scale * height);
  const [rx, ry, rz] = [0, 1, 2].map(
    (i) => (forward[i] ?? 0) + u * (right[i] ?? 0) + v * (up[i] ?? 0),
  ) as Vec3;
  const [ox, oy, oz] = placed.eye;
  const { positions, triangles } = mesh;
  const at = (i: number) => positions[i] ?? 0;
  let nearest = Infinity;
  let found: { t: number; b1: number; b2: number } | null = null;
  for (let t = 0; t < triangles.length / 3; t++) {
    const [i, j, k] = [3 * t, 3 * t + 1, 3 * t + 2].map((c) => 3 * (triangles[c] ?? 0)) as Vec3;
    const [ax, ay, az] = [at(i), at(i + 1), at(i + 2)];
    const [bx, by, bz] = [at(j) - ax, at(j + 1) - ay, at(j + 2) - az];
    const [cx, cy, cz] = [at(k) - ax, at(k + 1) - ay, at(k + 2) - az];
    const [px, py, pz] = [ry * cz - rz * cy, rz * cx - rx * cz, rx * cy - ry * cx];
    const det = bx * px + by * py + bz * pz;
    if (Math.abs(det) < 1e-20) continue;
    const [sx, sy, sz] = [ox - ax, oy - ay, oz - az];
    const b1 = (sx * px + sy * py + sz * pz) / det;
    if (b1 < 0 || b1 > 1) continue;
    const [qx, qy, qz] = [sy * bz - sz * by, sz * bx - sx * bz, sx * by - sy * bx];
    const b2 = (rx * qx + ry * qy + rz * qz) / det;
    if (b2 < 0 || b1 + b2 > 1) continue;
    const depth = (cx * qx + cy * qy + cz * qz) / det;
    if (!(depth > 0) || depth >= nearest) continue;
    nearest = depth;
    found = { t, b1, b2 };
  }
  if (!found) return null;
  return {
    object: objectOf(mesh, found.t),
    triangle: found.t,
    b1: found.b1,
    b2: found.b2,
    position: [ox + nearest * rx, oy + nearest * ry, oz + nearest * rz],
  };
}

export function objectOf(mesh: Mesh, triangle: number): number {
  const part = mesh.parts.find(
    (one) => 3 * triangle >= one.firstIndex && 3 * triangle < one.firstIndex + one.nIndex,
  );
  return part?.object ?? 0;
}
