// SPDX-License-Identifier: MIT
// Differences of colours as a person sees them: CIEDE2000 (ISO/CIE 11664-6; Sharma, Wu and Dalal
// 2005) of sRGB pictures, and a map of them.

export type Lab = [number, number, number];

const DEGREE = Math.PI / 180;
const decoded = Float64Array.from({ length: 256 }, (_, i) =>
  i <= 10.31475 ? i / 255 / 12.92 : ((i / 255 + 0.055) / 1.055) ** 2.4,
);
const WHITE = [0.950489, 1, 1.08884] as const; // D65 of sRGB's matrix

function response(t: number): number {
  return t > 216 / 24389 ? Math.cbrt(t) : ((24389 / 27) * t + 16) / 116;
}

/** CIELAB (D65) of an sRGB colour of 8 bits a channel. */
export function labOf(r: number, g: number, b: number): Lab {
  const [lr, lg, lb] = [decoded[r] ?? 0, decoded[g] ?? 0, decoded[b] ?? 0];
  const x = response((0.4123908 * lr + 0.3575843 * lg + 0.1804808 * lb) / WHITE[0]);
  const y = response((0.212639 * lr + 0.7151687 * lg + 0.0721923 * lb) / WHITE[1]);
  const z = response((0.0193308 * lr + 0.1191948 * lg + 0.9505322 * lb) / WHITE[2]);
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
}

function hue(a: number, b: number): number {
  if (a === 0 && b === 0) return 0;
  const h = Math.atan2(b, a) / DEGREE;
  return h < 0 ? h + 360 : h;
}

/** ΔE₀₀ of two colours; 1 is just noticeable, k_L = k_C = k_H = 1. */
export function deltaE2000(one: Lab, two: Lab): number {
  const chroma = (Math.hypot(one[1], one[2]) + Math.hypot(two[1], two[2])) / 2;
  const stretch = 1.5 - 0.5 * Math.sqrt(chroma ** 7 / (chroma ** 7 + 25 ** 7));
  const a1 = stretch * one[1];
  const a2 = stretch * two[1];
  const c1 = Math.hypot(a1, one[2]);
  const c2 = Math.hypot(a2, two[2]);
  const h1 = hue(a1, one[2]);
  const h2 = hue(a2, two[2]);
  const grey = c1 * c2 === 0;
  let dh = grey ? 0 : h2 - h1;
  if (dh > 180) dh -= 360;
  if (dh < -180) dh += 360;
  let h = h1 + h2;
  if (!grey) {
    if (Math.abs(h1 - h2) > 180) h += h < 360 ? 360 : -360;
    h /= 2;
  }
  const l = (one[0] + two[0]) / 2;
  const c = (c1 + c2) / 2;
  const t =
    1 -
    0.17 * Math.cos((h - 30) * DEGREE) +
    0.24 * Math.cos(2 * h * DEGREE) +
    0.32 * Math.cos((3 * h + 6) * DEGREE) -
    0.2 * Math.cos((4 * h - 63) * DEGREE);
  const sl = 1 + (0.015 * (l - 50) ** 2) / Math.sqrt(20 + (l - 50) ** 2);
  const sc = 1 + 0.045 * c;
  const sh = 1 + 0.015 * c * t;
  const turn = 30 * Math.exp(-(((h - 275) / 25) ** 2));
  const rt = -2 * Math.sqrt(c ** 7 / (c ** 7 + 25 ** 7)) * Math.sin(2 * turn * DEGREE);
  const x = (two[0] - one[0]) / sl;
  const y = (c2 - c1) / sc;
  const z = (2 * Math.sqrt(c1 * c2) * Math.sin((dh / 2) * DEGREE)) / sh;
  return Math.sqrt(x * x + y * y + z * z + rt * y * z);
}

/** ΔE that the map shows as its brightest colour. */
export const MAP_MOST = 10;
// Dark to bright, ordered in lightness.
const STOPS: readonly Lab[] = [
  [0, 0, 4],
  [64, 10, 103],
  [147, 38, 103],
  [221, 81, 58],
  [252, 165, 10],
  [252, 255, 164],
];
/** The colour of x in [0,1] in maps of numbers; sRGB, 8 bits. */
export function heat(x: number): Lab {
  const at = Math.min(1, Math.max(0, x)) * (STOPS.length - 1);
  const i = Math.min(STOPS.length - 2, Math.floor(at));
  const [lo, hi] = [STOPS[i], STOPS[i + 1]];
  return [0, 1, 2].map((c) =>
    Math.round((lo?.[c] ?? 0) + (at - i) * ((hi?.[c] ?? 0) - (lo?.[c] ?? 0))),
  ) as Lab;
}

export interface Difference {
  /** RGBA of the map, in the order of the pictures. */
  map: Uint8ClampedArray<ArrayBuffer>;
  /** Over pixels that differ from the background in one of the pictures. */
  mean: number;
  most: number;
  /** Share of these pixels with more than 2.3, which a person sees. */
  seen: number;
}

/** ΔE₀₀ of two pictures of equal size, RGBA of 8 bits; `counts` says which pixels the numbers are
 * about. */
export function difference(
  one: Uint8Array | Uint8ClampedArray,
  two: Uint8Array | Uint8ClampedArray,
  counts: (pixel: number) => boolean = () => true,
): Difference {
  const n = Math.min(one.length, two.length) / 4;
  const map = new Uint8ClampedArray(4 * n);
  let sum = 0;
  let most = 0;
  let seen = 0;
  let counted = 0;
  for (let i = 0; i < n; i++) {
    const [r, g, b, r2, g2, b2] = [0, 1, 2, 0, 1, 2].map(
      (c, k) => (k < 3 ? one : two)[4 * i + c] ?? 0,
    ) as [number, number, number, number, number, number];
    const same = r === r2 && g === g2 && b === b2;
    const e = same ? 0 : deltaE2000(labOf(r, g, b), labOf(r2, g2, b2));
    const [hr, hg, hb] = heat(e / MAP_MOST);
    map[4 * i] = hr;
    map[4 * i + 1] = hg;
    map[4 * i + 2] = hb;
    map[4 * i + 3] = 255;
    if (!counts(i)) continue;
    counted++;
    sum += e;
    most = Math.max(most, e);
    if (e > 2.3) seen++;
  }
  return { map, mean: sum / (counted || 1), most, seen: seen / (counted || 1) };
}
