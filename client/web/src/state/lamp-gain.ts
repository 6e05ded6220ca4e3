// SPDX-License-Identifier: MIT
// A lamp's gain as a colour and a strength. The colour is the gain over its largest channel; the
// strength is that channel, in EV.
import type { Vec3 } from "../scene/camera";

const LEAST = 1e-6;
const GAMMA = 2.2;

const most = (gain: Vec3) => Math.max(...gain);
const scaled = (v: Vec3, k: number): Vec3 => [k * v[0], k * v[1], k * v[2]];

/** EV. */
export const strengthOf = (gain: Vec3) => Math.log2(Math.max(most(gain), LEAST));

/** "#rrggbb"; of a lamp that is dark "#000000". */
export function hexOf(gain: Vec3): string {
  const top = Math.max(most(gain), LEAST);
  const byte = (x: number) => Math.round(255 * (x / top) ** (1 / GAMMA));
  return `#${gain.map((x) => byte(x).toString(16).padStart(2, "0")).join("")}`;
}

/** The gain in another colour and the same strength. Black has no hue: the gain stays. A lamp that
 * is dark gets 0 EV. */
export function tinted(gain: Vec3, hex: string): Vec3 {
  const channel = (i: number) => (parseInt(hex.slice(i, i + 2), 16) / 255) ** GAMMA;
  const rgb: Vec3 = [channel(1), channel(3), channel(5)];
  const top = most(rgb);
  if (!(top > 0)) return gain;
  return scaled(rgb, (most(gain) > LEAST ? most(gain) : 1) / top);
}

/** The gain in the same colour and another strength [EV]. A lamp that is dark becomes white. */
export function brightened(gain: Vec3, ev: number): Vec3 {
  const top = most(gain);
  return top > LEAST ? scaled(gain, 2 ** ev / top) : scaled([1, 1, 1], 2 ** ev);
}
