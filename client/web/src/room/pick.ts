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

const vertex = (mesh: Mesh, i: number): Vec3 => [
  mesh.positions[3 * i] ?? 0,
  mesh.positions[3 * i + 1] ?? 0,
  mesh.positions[3 * i + 2] ?? 0,
];

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
  const ray: Vec3 = [0, 1, 2].map(
    (i) => (forward[i] ?? 0) + u * (right[i] ?? 0) + v * (up[i] ?? 0),
  ) as Vec3;
  let nearest = Infinity;
  let found: Point | null = null;
  for (let t = 0; t < mesh.triangles.length / 3; t++) {
    const a = vertex(mesh, mesh.triangles[3 * t] ?? 0);
    const ab = less(vertex(mesh, mesh.triangles[3 * t + 1] ?? 0), a);
    const ac = less(vertex(mesh, mesh.triangles[3 * t + 2] ?? 0), a);
    const p = cross(ray, ac);
    const det = dot(ab, p);
    if (Math.abs(det) < 1e-20) continue;
    const s = less(placed.eye, a);
    const b1 = dot(s, p) / det;
    if (b1 < 0 || b1 > 1) continue;
    const q = cross(s, ab);
    const b2 = dot(ray, q) / det;
    if (b2 < 0 || b1 + b2 > 1) continue;
    const depth = dot(ac, q) / det;
    if (!(depth > 0) || depth >= nearest) continue;
    nearest = depth;
    found = {
      object: objectOf(mesh, t),
      triangle: t,
      b1,
      b2,
      position: [0, 1, 2].map((i) => (placed.eye[i] ?? 0) + depth * (ray[i] ?? 0)) as Vec3,
    };
  }
  return found;
}

function objectOf(mesh: Mesh, triangle: number): number {
  const part = mesh.parts.find(
    (one) => 3 * triangle >= one.firstIndex && 3 * triangle < one.firstIndex + one.nIndex,
  );
  return part?.object ?? 0;
}
