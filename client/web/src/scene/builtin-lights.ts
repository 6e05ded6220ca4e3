// SPDX-License-Identifier: MIT
// Environments that the page computes itself, so that there is light before anybody uploads one.
import { faceDirection, type Cube } from "./environment";
import type { Vec3 } from "./camera";

export interface BuiltinLight {
  id: string;
  name: string;
  radiance: (d: Vec3) => Vec3;
}

const smooth = (lo: number, hi: number, x: number) => {
  const t = Math.min(1, Math.max(0, (x - lo) / (hi - lo)));
  return t * t * (3 - 2 * t);
};
const mix = (a: Vec3, b: Vec3, t: number): Vec3 => [
  a[0] + (b[0] - a[0]) * t,
  a[1] + (b[1] - a[1]) * t,
  a[2] + (b[2] - a[2]) * t,
];
const scaled = (a: Vec3, k: number): Vec3 => [a[0] * k, a[1] * k, a[2] * k];
const sum = (...all: Vec3[]): Vec3 =>
  all.reduce<Vec3>((a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]], [0, 0, 0]);

/** A soft rectangle of light: its middle in degrees (azimuth as the camera's), half widths, color. */
function box(
  d: Vec3,
  azimuth: number,
  elevation: number,
  width: number,
  height: number,
  color: Vec3,
): Vec3 {
  const a = (Math.atan2(d[0], d[2]) * 180) / Math.PI;
  const e = (Math.asin(Math.min(1, Math.max(-1, d[1]))) * 180) / Math.PI;
  const da =
    Math.abs(((a - azimuth + 540) % 360) - 180) * Math.cos((elevation * Math.PI) / 180);
  const inside =
    (1 - smooth(width - 5, width + 5, da)) *
    (1 - smooth(height - 5, height + 5, Math.abs(e - elevation)));
  return scaled(color, inside);
}

const STUDIO_WALL: Vec3 = [0.045, 0.047, 0.055];

export const BUILTIN_LIGHTS: readonly BuiltinLight[] = [
  {
    id: "studio",
    name: "Soft boxes",
    radiance: (d) =>
      sum(
        scaled(STUDIO_WALL, 0.6 + 0.4 * d[1]),
        box(d, 145, 25, 24, 34, [15, 13.4, 11.6]),
        box(d, -60, 20, 16, 30, [2.2, 2.6, 3.3]),
        box(d, 0, 78, 40, 12, [2.6, 2.5, 2.4]),
      ),
  },
  {
    id: "window",
    name: "Window",
    radiance: (d) => {
      const panes = [-1, 1].flatMap((i) =>
        [-1, 1].map((k) => box(d, -70 + 13 * i, 18 + 13 * k, 10, 10, [7, 8.2, 10])),
      );
      return sum(mix([0.09, 0.07, 0.05], [0.16, 0.14, 0.12], 0.5 + 0.5 * d[1]), ...panes);
    },
  },
  {
    id: "sunset",
    name: "Low sun",
    radiance: (d) => {
      const up = Math.max(0, d[1]);
      const s: Vec3 = [
        Math.sin(2.5) * Math.cos(0.16),
        Math.sin(0.16),
        Math.cos(2.5) * Math.cos(0.16),
      ];
      const c = d[0] * s[0] + d[1] * s[1] + d[2] * s[2];
      const sky = mix([0.95, 0.42, 0.2], [0.13, 0.2, 0.42], smooth(0, 0.55, up));
      const glow = scaled([2.6, 1.05, 0.36], Math.pow(Math.max(0, c), 24));
      const sun = scaled([95, 52, 24], smooth(0.988, 0.997, c));
      return d[1] < 0 ? scaled([0.11, 0.075, 0.06], 1 + 2 * d[1] * d[1]) : sum(sky, glow, sun);
    },
  },
  {
    id: "overcast",
    name: "Overcast",
    radiance: (d) =>
      d[1] < 0 ? [0.16, 0.15, 0.14] : scaled([0.78, 0.84, 0.92], (1 + 2 * d[1]) / 2.2),
  },
  {
    id: "rim",
    name: "Two rims",
    radiance: (d) =>
      sum(
        [0.012, 0.012, 0.016],
        box(d, 160, 10, 10, 50, [18, 10, 5.4]),
        box(d, -150, 10, 10, 50, [4, 8, 18]),
      ),
  },
];

const made = new Map<string, Cube>();
/** The cube of "page:ID" with n texels a side, each the mean of 3 x 3 points; null: no such light. */
export function builtinCube(env: string, n = 64): Cube | null {
  const light = BUILTIN_LIGHTS.find((one) => `page:${one.id}` === env);
  if (!light) return null;
  const key = `${env}/${n}`;
  const known = made.get(key);
  if (known) return known;
  const texel = new Float32Array(18 * n * n);
  const fine = 3;
  for (let i = 0; i < 6 * n * n; i++)
    for (let q = 0; q < fine * fine; q++) {
      const x = (i % n) + ((q % fine) + 0.5) / fine;
      const y = (Math.floor(i / n) % n) + (Math.floor(q / fine) + 0.5) / fine;
      const rgb = light.radiance(
        faceDirection(Math.floor(i / (n * n)), (2 * x) / n - 1, (2 * y) / n - 1),
      );
      for (let c = 0; c < 3; c++)
        texel[3 * i + c] = (texel[3 * i + c] ?? 0) + (rgb[c] ?? 0) / (fine * fine);
    }
  const cube = { n, texel };
  made.set(key, cube);
  return cube;
}

/** Uniform radiance. */
export function constantCube(env: string): Cube {
  const rgb = env.startsWith("constant:") ? env.slice(9).split(",").map(Number) : [1, 1, 1];
  const texel = new Float32Array(18 * 16);
  for (let i = 0; i < texel.length; i++) texel[i] = rgb[i % 3] ?? 1;
  return { n: 4, texel };
}
