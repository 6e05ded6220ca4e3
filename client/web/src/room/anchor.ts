// SPDX-License-Identifier: MIT
// Where a pin lies on the mesh that is shown now: on its own triangle where the mesh is the pin's,
// also when vertices moved; else on the nearest point of the surface, if one is near enough.
import type { Seen, SurfacePoint } from "../gen/relight_pb";
import type { Vec3 } from "../scene/camera";
import type { Mesh } from "../scene/geometry";

/** Of the diagonal of the model's bounding box: farther away is another place. */
export const MOST_DISTANCE = 0.01;

export interface Anchor {
  /** same: as it was. moved: its triangle is elsewhere. placed: on another model. */
  state: "same" | "moved" | "placed" | "lost";
  /** From where the pin was, in diagonals; Infinity: more than MOST_DISTANCE. */
  distance: number;
  position: Vec3;
  /** Of the triangle, of unit length; zero where it is not known. */
  normal: Vec3;
}

const NONE: Vec3 = [0, 0, 0];
const less = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function corner(mesh: Mesh, triangle: number, i: number): Vec3 {
  const v = 3 * (mesh.triangles[3 * triangle + i] ?? 0);
  return [mesh.positions[v] ?? 0, mesh.positions[v + 1] ?? 0, mesh.positions[v + 2] ?? 0];
}
function pointOf(mesh: Mesh, triangle: number, b1: number, b2: number): Vec3 {
  const [a, b, c] = [0, 1, 2].map((i) => corner(mesh, triangle, i)) as [Vec3, Vec3, Vec3];
  return [0, 1, 2].map(
    (k) => (1 - b1 - b2) * (a[k] ?? 0) + b1 * (b[k] ?? 0) + b2 * (c[k] ?? 0),
  ) as Vec3;
}
function normalOf(mesh: Mesh, triangle: number): Vec3 {
  const a = corner(mesh, triangle, 0);
  const [ux, uy, uz] = less(corner(mesh, triangle, 1), a);
  const [vx, vy, vz] = less(corner(mesh, triangle, 2), a);
  const n: Vec3 = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
  const size = Math.hypot(...n) || 1;
  return [n[0] / size, n[1] / size, n[2] / size];
}

/** Weights of the second and third corner of the triangle's point that is nearest to p
 * (Ericson, Real-Time Collision Detection, 5.1.5). */
export function nearestInTriangle(p: Vec3, a: Vec3, b: Vec3, c: Vec3): [number, number] {
  const [ab, ac] = [less(b, a), less(c, a)];
  const [ap, bp, cp] = [less(p, a), less(p, b), less(p, c)];
  const [d1, d2, d3, d4] = [dot(ab, ap), dot(ac, ap), dot(ab, bp), dot(ac, bp)];
  const [d5, d6] = [dot(ab, cp), dot(ac, cp)];
  const [va, vb, vc] = [d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2];
  if (d1 <= 0 && d2 <= 0) return [0, 0];
  if (d3 >= 0 && d4 <= d3) return [1, 0];
  if (d6 >= 0 && d5 <= d6) return [0, 1];
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return [d1 / (d1 - d3), 0];
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return [0, d2 / (d2 - d6)];
  if (va <= 0 && d4 >= d3 && d5 >= d6) {
    const w = (d4 - d3) / (d4 - d3 + d5 - d6);
    return [1 - w, w];
  }
  const sum = va + vb + vc;
  return sum > 0 ? [vb / sum, vc / sum] : [0, 0];
}

// ---- triangles by cells, so that points near the surface find theirs

interface Grid {
  low: Vec3;
  diagonal: number;
  cell: number;
  triangles: Map<number, number[]>;
}
const SIDE = 64; // cells along the diagonal: each is wider than MOST_DISTANCE
const grids = new WeakMap<Mesh, Grid>();

function boxOf(mesh: Mesh): { low: Vec3; diagonal: number } {
  const low: Vec3 = [Infinity, Infinity, Infinity];
  const high: Vec3 = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < mesh.positions.length; i++) {
    const x = mesh.positions[i] ?? 0;
    const k = i % 3;
    low[k] = Math.min(low[k] ?? x, x);
    high[k] = Math.max(high[k] ?? x, x);
  }
  return { low, diagonal: Math.hypot(...less(high, low)) || 1 };
}
const keyOf = (x: number, y: number, z: number) => (x + 1) * 16384 + (y + 1) * 128 + z + 1;

function gridOf(mesh: Mesh): Grid {
  const known = grids.get(mesh);
  if (known) return known;
  const { low, diagonal } = boxOf(mesh);
  const cell = diagonal / SIDE;
  const triangles = new Map<number, number[]>();
  const cellOf = (x: number, k: number) => Math.floor((x - (low[k] ?? 0)) / cell);
  for (let t = 0; t < mesh.triangles.length / 3; t++) {
    const p = [0, 1, 2].map((i) => corner(mesh, t, i)) as [Vec3, Vec3, Vec3];
    const [from, to] = [Math.min, Math.max].map((f) =>
      [0, 1, 2].map((k) => cellOf(f(p[0][k] ?? 0, p[1][k] ?? 0, p[2][k] ?? 0), k)),
    ) as [Vec3, Vec3];
    for (let x = from[0]; x <= to[0]; x++)
      for (let y = from[1]; y <= to[1]; y++)
        for (let z = from[2]; z <= to[2]; z++) {
          const key = keyOf(x, y, z);
          const list = triangles.get(key);
          if (list) list.push(t);
          else triangles.set(key, [t]);
        }
  }
  const grid = { low, diagonal, cell, triangles };
  grids.set(mesh, grid);
  return grid;
}

function nearest(mesh: Mesh, p: Vec3): Anchor {
  const grid = gridOf(mesh);
  const [cx, cy, cz] = p.map((x, k) =>
    Math.floor((x - (grid.low[k] ?? 0)) / grid.cell),
  ) as Vec3;
  let best = MOST_DISTANCE * grid.diagonal;
  let out: Anchor = { state: "lost", distance: Infinity, position: p, normal: NONE };
  for (let i = 0; i < 27; i++) {
    const key = keyOf(
      cx + (i % 3) - 1,
      cy + (Math.floor(i / 3) % 3) - 1,
      cz + Math.floor(i / 9) - 1,
    );
    for (const t of grid.triangles.get(key) ?? []) {
      const [a, b, c] = [0, 1, 2].map((j) => corner(mesh, t, j)) as [Vec3, Vec3, Vec3];
      const [w1, w2] = nearestInTriangle(p, a, b, c);
      const position = pointOf(mesh, t, w1, w2);
      const d = Math.hypot(...less(p, position));
      if (d > best) continue;
      best = d;
      out = {
        state: "placed",
        distance: d / grid.diagonal,
        position,
        normal: normalOf(mesh, t),
      };
    }
  }
  return out;
}

// ---- anchors

/** Whether triangles have the numbers that the pin's model had. Where a hash is not known, the
 * same model stands for the same mesh. */
export function sameMesh(mesh: Mesh, model: string, seen: Seen | undefined): boolean {
  if (seen?.meshHash && mesh.hash) return seen.meshHash === mesh.hash;
  return seen?.model === model;
}

export function anchorOf(mesh: Mesh, isSame: boolean, at: SurfacePoint | undefined): Anchor {
  const p = at?.position;
  const was: Vec3 | null = p ? [p.x, p.y, p.z] : null;
  if (at && isSame && 3 * at.triangle < mesh.triangles.length) {
    const position = pointOf(mesh, at.triangle, at.b1, at.b2);
    const { diagonal } = gridBox(mesh);
    const distance = was ? Math.hypot(...less(was, position)) / diagonal : 0;
    return {
      state: distance > 1e-5 ? "moved" : "same",
      distance,
      position,
      normal: normalOf(mesh, at.triangle),
    };
  }
  if (was) return nearest(mesh, was);
  return { state: "lost", distance: Infinity, position: NONE, normal: NONE };
}
const boxes = new WeakMap<Mesh, { low: Vec3; diagonal: number }>();
function gridBox(mesh: Mesh): { low: Vec3; diagonal: number } {
  let box = boxes.get(mesh);
  if (!box) boxes.set(mesh, (box = boxOf(mesh)));
  return box;
}

/** Whether a stroke's points, of a model that is not known, have this mesh's triangles. */
export function fitsMesh(mesh: Mesh, points: readonly SurfacePoint[]): boolean {
  const first = points.find((point) => point.position);
  return first !== undefined && anchorOf(mesh, true, first).state === "same";
}

export const facesAway = (anchor: Anchor, eye: Vec3) =>
  dot(anchor.normal, less(eye, anchor.position)) < 0;

/** What became of a pin, in words; empty: it is where it was. */
export function anchorText(anchor: Anchor): string {
  const share = `${(100 * anchor.distance).toPrecision(2)} % of the model's size`;
  if (anchor.state === "moved") return `Its place on the surface has moved by ${share}.`;
  if (anchor.state === "placed")
    return `Placed on another model: the nearest surface is ${share} away.`;
  if (anchor.state === "lost")
    return `It cannot be placed on this model: no surface is within ${100 * MOST_DISTANCE} % of the model's size.`;
  return "";
}
