// SPDX-License-Identifier: MIT
// Environments as cubes: decoding, turning, and the GGX filter of reflections. The filter is that
// of the daemon (METHODS §6 and libprt/raster/specular.c), so that pictures agree.

/** Radiance of a cube: [6][n][n][3], faces +X -X +Y -Y +Z -Z with OpenGL's axes. */
export interface Cube {
  n: number;
  texel: Float32Array;
}

type Vec = [number, number, number];

/** RGB9E5 words to linear floats. */
export function decodeRgb9e5(words: Uint32Array): Float32Array {
  const out = new Float32Array(words.length * 3);
  for (let i = 0; i < words.length; i++) {
    const w = words[i] ?? 0;
    const scale = 2 ** ((w >>> 27) - 24);
    out[3 * i] = (w & 511) * scale;
    out[3 * i + 1] = ((w >>> 9) & 511) * scale;
    out[3 * i + 2] = ((w >>> 18) & 511) * scale;
  }
  return out;
}

/** The direction of (s, t) in [-1,1]² on a face; unit length. */
export function faceDirection(face: number, s: number, t: number): Vec {
  const l = 1 / Math.sqrt(1 + s * s + t * t);
  const [x, y, z] = (
    [
      [1, -t, -s],
      [-1, -t, s],
      [s, 1, t],
      [s, -1, -t],
      [s, -t, 1],
      [-s, -t, -1],
    ] as const
  )[face as 0 | 1 | 2 | 3 | 4 | 5];
  return [x * l, y * l, z * l];
}

/** The cube face of a direction, and the coordinates on it. */
export function faceOf(x: number, y: number, z: number): [number, number, number] {
  const ax = Math.abs(x);
  const ay = Math.abs(y);
  const az = Math.abs(z);
  if (ax >= ay && ax >= az) return x < 0 ? [1, z / ax, -y / ax] : [0, -z / ax, -y / ax];
  if (ay >= az) return y < 0 ? [3, x / ay, -z / ay] : [2, x / ay, z / ay];
  return z < 0 ? [5, -x / az, -y / az] : [4, x / az, -y / az];
}

/** A cube with a border of one texel round each face, four floats a texel: bilinear look-ups in
 * it need no seams. [6][n+2][n+2][4]. */
export function bordered(cube: Cube): Float32Array {
  const { n, texel } = cube;
  const m = n + 2;
  const out = new Float32Array(6 * m * m * 4);
  for (let face = 0; face < 6; face++)
    for (let y = 0; y < m; y++)
      for (let x = 0; x < m; x++) {
        let from = face;
        let px = x - 1;
        let py = y - 1;
        if (px < 0 || py < 0 || px >= n || py >= n) {
          const d = faceDirection(face, (2 * x - 1) / n - 1, (2 * y - 1) / n - 1);
          const [other, s, t] = faceOf(...d);
          from = other;
          px = Math.min(n - 1, Math.max(0, Math.floor((s * 0.5 + 0.5) * n)));
          py = Math.min(n - 1, Math.max(0, Math.floor((t * 0.5 + 0.5) * n)));
        }
        const to = ((face * m + y) * m + x) * 4;
        const at = ((from * n + py) * n + px) * 3;
        out[to] = texel[at] ?? 0;
        out[to + 1] = texel[at + 1] ?? 0;
        out[to + 2] = texel[at + 2] ?? 0;
        out[to + 3] = 1;
      }
  return out;
}

/** Mean over blocks of texels by solid angle, so that power is kept; n divides cube.n. */
export function reduced(cube: Cube, n: number): Cube {
  const k = cube.n / n;
  if (k === 1) return cube;
  const texel = new Float32Array(18 * n * n);
  for (let face = 0; face < 6; face++)
    for (let y = 0; y < n; y++)
      for (let x = 0; x < n; x++) {
        const sum = [0, 0, 0];
        let total = 0;
        for (let b = y * k; b < (y + 1) * k; b++)
          for (let a = x * k; a < (x + 1) * k; a++) {
            const s = (2 * a + 1) / cube.n - 1;
            const t = (2 * b + 1) / cube.n - 1;
            const w = (1 + s * s + t * t) ** -1.5;
            const at = ((face * cube.n + b) * cube.n + a) * 3;
            total += w;
            for (let c = 0; c < 3; c++) sum[c] = (sum[c] ?? 0) + w * (cube.texel[at + c] ?? 0);
          }
        const to = ((face * n + y) * n + x) * 3;
        for (let c = 0; c < 3; c++) texel[to + c] = (sum[c] ?? 0) / total;
      }
  return { n, texel };
}

/** Light of one lamp: its cube, its turn about +y and its tilt about the camera-independent x
 * axis, and a factor for each channel. */
export interface Lamp {
  cube: Cube;
  rotateDeg: number;
  tiltDeg: number;
  gain: Vec;
}

/** Turns a direction of the world into the environment's own: the opposite of rotate, then of
 * tilt. rotateDeg is counter-clockwise about +y seen from above. */
export function intoEnvironment(d: Vec, rotateDeg: number, tiltDeg: number): Vec {
  const a = (rotateDeg * Math.PI) / 180;
  const b = (tiltDeg * Math.PI) / 180;
  const x = d[0] * Math.cos(a) - d[2] * Math.sin(a);
  const z = d[0] * Math.sin(a) + d[2] * Math.cos(a);
  const y = d[1] * Math.cos(b) + z * Math.sin(b);
  return [x, y, z * Math.cos(b) - d[1] * Math.sin(b)];
}

/** The sum of lamps in n x n texels a face. Each texel is the mean of `fine`² points. */
export function summed(lamps: readonly Lamp[], n: number, fine = 2): Cube {
  const texel = new Float32Array(18 * n * n);
  const step = 1 / (n * fine);
  for (const lamp of lamps) {
    const still = lamp.rotateDeg % 360 === 0 && lamp.tiltDeg === 0;
    const cube =
      lamp.cube.n > n && lamp.cube.n % n === 0 && still ? reduced(lamp.cube, n) : lamp.cube;
    const edge = bordered(cube.n > 4 * n ? reduced(cube, 4 * n) : cube);
    const size = cube.n > 4 * n ? 4 * n : cube.n;
    const places = still && size === n ? 1 : fine;
    for (let i = 0; i < 6 * n * n; i++) {
      const face = Math.floor(i / (n * n));
      const y = Math.floor(i / n) % n;
      const x = i % n;
      for (let q = 0; q < places * places; q++) {
        const s =
          places === 1 ? (2 * x + 1) / n - 1 : 2 * (x * fine + (q % fine) + 0.5) * step - 1;
        const t =
          places === 1
            ? (2 * y + 1) / n - 1
            : 2 * (y * fine + Math.floor(q / fine) + 0.5) * step - 1;
        const d = intoEnvironment(faceDirection(face, s, t), lamp.rotateDeg, lamp.tiltDeg);
        add(edge, size, d, lamp.gain, 1 / (places * places), texel, 3 * i);
      }
    }
  }
  return { n, texel };
}

// Adds k gain times the bilinear radiance of a bordered cube in direction d.
function add(
  edge: Float32Array,
  n: number,
  d: Vec,
  gain: Vec,
  k: number,
  out: Float32Array,
  at: number,
): void {
  const [face, s, t] = faceOf(...d);
  const m = n + 2;
  const x = Math.min(n + 0.5, Math.max(0.5, (s * 0.5 + 0.5) * n + 0.5));
  const y = Math.min(n + 0.5, Math.max(0.5, (t * 0.5 + 0.5) * n + 0.5));
  const x0 = Math.floor(x);
  const y0 = Math.floor(y);
  const fx = x - x0;
  const fy = y - y0;
  const p = ((face * m + y0) * m + x0) * 4;
  for (let c = 0; c < 3; c++) {
    const top = (edge[p + c] ?? 0) * (1 - fx) + (edge[p + 4 + c] ?? 0) * fx;
    const low = (edge[p + 4 * m + c] ?? 0) * (1 - fx) + (edge[p + 4 * m + 4 + c] ?? 0) * fx;
    out[at + c] = (out[at + c] ?? 0) + k * (gain[c] ?? 1) * (top * (1 - fy) + low * fy);
  }
}

// ---- the filter of reflections

/** Levels of growing roughness; the shader reads between two. */
export const ROUGHNESS = [0, 0.15, 0.3, 0.45, 0.65, 1] as const;
/** Texels along a side of every level, as the shader sees it. */
export const LEVEL_SIDE = 32;
const LEVEL_SIZE = [32, 32, 16, 16, 8, 8] as const;
const LEVEL_FROM = [32, 32, 16, 8, 8, 8] as const;
const LOBE_CUT = 500; // the lobe is cut where it falls to one over this of its peak

interface Filter {
  begin: Uint32Array;
  index: Uint16Array;
  weight: Float32Array;
}
const filters: (Filter | undefined)[] = [];

const BLOCK = 8; // texels along a side of the blocks by which texels are left out

// Texels of an n-cube that may lie within acos(near) of d: those of the blocks that reach there.
function* candidates(n: number, d: Vec, near: number): Generator<number> {
  const blocks = n / BLOCK;
  // A block at the middle of a face reaches farthest.
  const reach = Math.atan((Math.SQRT2 * BLOCK) / n);
  const least = Math.cos(Math.min(Math.PI, Math.acos(Math.max(-1, near)) + reach));
  for (let b = 0; b < 6 * blocks * blocks; b++) {
    const face = Math.floor(b / (blocks * blocks));
    const x = (b % blocks) * BLOCK;
    const y = (Math.floor(b / blocks) % blocks) * BLOCK;
    const c = faceDirection(face, (2 * x + BLOCK) / n - 1, (2 * y + BLOCK) / n - 1);
    if (c[0] * d[0] + c[1] * d[1] + c[2] * d[2] < least) continue;
    for (let k = 0; k < BLOCK * BLOCK; k++)
      yield (face * n + y + Math.floor(k / BLOCK)) * n + x + (k % BLOCK);
  }
}

function makeFilter(level: number): Filter {
  const n = LEVEL_SIZE[level] ?? 8;
  const from = LEVEL_FROM[level] ?? 8;
  const alpha2 = (ROUGHNESS[level] ?? 1) ** 4;
  const theta = Math.atan(Math.sqrt(alpha2) * Math.sqrt(Math.sqrt(LOBE_CUT) - 1));
  const cut = 2 * theta < Math.PI / 2 ? Math.cos(2 * theta) : 0;
  const near = cut - 1.5 / from;
  const fine = level === 1 ? 4 : 2;
  const count = 6 * from * from;
  const centre = new Float32Array(count * 3);
  const area = new Float32Array(count);
  const place = new Float32Array(count * fine * fine * 3);
  for (let i = 0; i < count; i++) {
    const face = Math.floor(i / (from * from));
    const y = Math.floor(i / from) % from;
    const x = i % from;
    const s = (2 * x + 1) / from - 1;
    const t = (2 * y + 1) / from - 1;
    centre.set(faceDirection(face, s, t), 3 * i);
    area[i] = (1 + s * s + t * t) ** -1.5;
    for (let q = 0; q < fine * fine; q++)
      place.set(
        faceDirection(
          face,
          (2 * (x + ((q % fine) + 0.5) / fine)) / from - 1,
          (2 * (y + (Math.floor(q / fine) + 0.5) / fine)) / from - 1,
        ),
        3 * (i * fine * fine + q),
      );
  }
  const begin = new Uint32Array(6 * n * n + 1);
  const index: number[] = [];
  const weight: number[] = [];
  for (let row = 0; row < 6 * n * n; row++) {
    const [dx, dy, dz] = faceDirection(
      Math.floor(row / (n * n)),
      (2 * (row % n) + 1) / n - 1,
      (2 * (Math.floor(row / n) % n) + 1) / n - 1,
    );
    const first = weight.length;
    let total = 0;
    for (const i of candidates(from, [dx, dy, dz], near)) {
      const c0 =
        (centre[3 * i] ?? 0) * dx +
        (centre[3 * i + 1] ?? 0) * dy +
        (centre[3 * i + 2] ?? 0) * dz;
      if (c0 < near) continue;
      let sum = 0;
      for (let q = i * fine * fine; q < (i + 1) * fine * fine; q++) {
        const c =
          (place[3 * q] ?? 0) * dx +
          (place[3 * q + 1] ?? 0) * dy +
          (place[3 * q + 2] ?? 0) * dz;
        const e = (1 + c) * 0.5 * (alpha2 - 1) + 1;
        if (c > cut) sum += c / (e * e);
      }
      if (!(sum > 0)) continue;
      index.push(i);
      weight.push(sum * (area[i] ?? 0));
      total += sum * (area[i] ?? 0);
    }
    for (let k = first; k < weight.length; k++) weight[k] = (weight[k] ?? 0) / total;
    begin[row + 1] = weight.length;
  }
  return { begin, index: Uint16Array.from(index), weight: Float32Array.from(weight) };
}

function applied(filter: Filter, input: Cube, n: number): Cube {
  const texel = new Float32Array(18 * n * n);
  const from = input.texel;
  for (let row = 0; row < 6 * n * n; row++) {
    let r = 0;
    let g = 0;
    let b = 0;
    for (let i = filter.begin[row] ?? 0; i < (filter.begin[row + 1] ?? 0); i++) {
      const w = filter.weight[i] ?? 0;
      const at = 3 * (filter.index[i] ?? 0);
      r += w * (from[at] ?? 0);
      g += w * (from[at + 1] ?? 0);
      b += w * (from[at + 2] ?? 0);
    }
    texel[3 * row] = r;
    texel[3 * row + 1] = g;
    texel[3 * row + 2] = b;
  }
  return { n, texel };
}

function enlarged(cube: Cube): Cube {
  if (cube.n === LEVEL_SIDE) return cube;
  const texel = new Float32Array(18 * LEVEL_SIDE * LEVEL_SIDE);
  const edge = bordered(cube);
  for (let i = 0; i < 6 * LEVEL_SIDE * LEVEL_SIDE; i++) {
    const s = (2 * (i % LEVEL_SIDE) + 1) / LEVEL_SIDE - 1;
    const t = (2 * (Math.floor(i / LEVEL_SIDE) % LEVEL_SIDE) + 1) / LEVEL_SIDE - 1;
    const d = faceDirection(Math.floor(i / (LEVEL_SIDE * LEVEL_SIDE)), s, t);
    add(edge, cube.n, d, [1, 1, 1], 1, texel, 3 * i);
  }
  return { n: LEVEL_SIDE, texel };
}

/** The levels one after another, bordered: [6 levels][6 faces][34][34][4]. `light` has 32 texels
 * a side. The first call computes the weights (a tenth of a second). */
export function filterStack(light: Cube): Float32Array {
  const half = reduced(light, 16);
  const quarter = reduced(half, 8);
  const m = LEVEL_SIDE + 2;
  const out = new Float32Array(ROUGHNESS.length * 6 * m * m * 4);
  ROUGHNESS.forEach((_, level) => {
    const from = LEVEL_FROM[level];
    const input = from === 32 ? light : from === 16 ? half : quarter;
    if (level && !filters[level]) filters[level] = makeFilter(level);
    const filter = filters[level];
    const cube = filter ? applied(filter, input, LEVEL_SIZE[level] ?? 8) : light;
    out.set(bordered(enlarged(cube)), level * 6 * m * m * 4);
  });
  return out;
}
