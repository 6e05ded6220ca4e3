// SPDX-License-Identifier: MIT
// The camera about a model: azimuth, elevation, magnification and a shift of its target. It keeps
// its distance while it orbits, so that the model does not change its size.

export type Vec3 = [number, number, number];

/** Degrees, as --orbit of prt; pan in units of the framed radius, along the picture. */
export interface Orbit {
  azimuth: number;
  elevation: number;
  zoom: number;
  panX: number;
  panY: number;
}
export const START: Orbit = { azimuth: 0, elevation: 15, zoom: 1, panX: 0, panY: 0 };
export const ZOOM_LEAST = 0.25;
export const ZOOM_MOST = 12;

export interface Placed {
  eye: Vec3;
  target: Vec3;
  up: Vec3;
  fovyDeg: number;
}

const DEGREE = Math.PI / 180;
// Share of the sphere round the box that fills the picture; models stay inside it.
const FIT = 0.86;
export const FOVY = 36;

interface View {
  back: Vec3;
  right: Vec3;
  up: Vec3;
}
function viewOf(azimuthDeg: number, elevationDeg: number): View {
  const sa = Math.sin(azimuthDeg * DEGREE);
  const ca = Math.cos(azimuthDeg * DEGREE);
  const se = Math.sin(elevationDeg * DEGREE);
  const ce = Math.cos(elevationDeg * DEGREE);
  return { back: [sa * ce, se, ca * ce], right: [ca, 0, -sa], up: [-sa * se, ce, -ca * se] };
}

/** The points that a camera frames: the middle of their box, and the farthest one from it. */
export interface Frame {
  centre: Vec3;
  radius: number;
}

/** positions [n][3]; `framed` says which vertices count. */
export function frameOf(positions: Float32Array, framed: (vertex: number) => boolean): Frame {
  const lo: Vec3 = [Infinity, Infinity, Infinity];
  const hi: Vec3 = [-Infinity, -Infinity, -Infinity];
  for (let v = 0; v < positions.length / 3; v++)
    for (let i = 0; framed(v) && i < 3; i++) {
      const x = positions[3 * v + i] ?? 0;
      lo[i] = Math.min(lo[i] ?? x, x);
      hi[i] = Math.max(hi[i] ?? x, x);
    }
  if (!(lo[0] <= hi[0])) return { centre: [0, 0, 0], radius: 1 };
  const centre: Vec3 = [(lo[0] + hi[0]) / 2, (lo[1] + hi[1]) / 2, (lo[2] + hi[2]) / 2];
  let radius = 0;
  for (let v = 0; v < positions.length / 3; v++)
    if (framed(v)) {
      const [x, y, z] = [0, 1, 2].map((i) => (positions[3 * v + i] ?? 0) - (centre[i] ?? 0));
      radius = Math.max(radius, Math.hypot(x ?? 0, y ?? 0, z ?? 0));
    }
  return { centre, radius: radius || 1 };
}

/** The frame of a box, where the vertices are not here. */
export function frameOfBox(lo: Vec3, hi: Vec3): Frame {
  return frameOf(Float32Array.from([...lo, ...hi]), () => true);
}

/** Where the camera stands, in the unit of the frame. */
export function place(frame: Frame, orbit: Orbit, aspect: number): Placed {
  const view = viewOf(orbit.azimuth, orbit.elevation);
  const half = Math.atan(Math.tan((FOVY * DEGREE) / 2) * Math.min(1, aspect));
  const distance = (FIT * frame.radius) / Math.sin(half);
  const { centre } = frame;
  const shift = [0, 1, 2].map(
    (i) => frame.radius * (orbit.panX * (view.right[i] ?? 0) + orbit.panY * (view.up[i] ?? 0)),
  );
  const target = centre.map((x, i) => x + (shift[i] ?? 0)) as Vec3;
  return {
    target,
    eye: target.map((x, i) => x + distance * (view.back[i] ?? 0)) as Vec3,
    up: view.up,
    fovyDeg: (2 * Math.atan(Math.tan((FOVY * DEGREE) / 2) / orbit.zoom)) / DEGREE,
  };
}

export function clampOrbit(orbit: Orbit): Orbit {
  const limit = (x: number, least: number, most: number) => Math.min(most, Math.max(least, x));
  return {
    azimuth: ((orbit.azimuth % 360) + 360) % 360,
    elevation: limit(orbit.elevation, -89, 89),
    zoom: limit(orbit.zoom, ZOOM_LEAST, ZOOM_MOST),
    panX: limit(orbit.panX, -2, 2),
    panY: limit(orbit.panY, -2, 2),
  };
}
