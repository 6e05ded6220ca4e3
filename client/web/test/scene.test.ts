// SPDX-License-Identifier: MIT
import { DataUtils } from "three";
import { describe, expect, test } from "vitest";
import { builtinCube, BUILTIN_LIGHTS } from "../src/scene/builtin-lights";
import { clampOrbit, frameOf, place, START, type Vec3 } from "../src/scene/camera";
import {
  bordered,
  decodeRgb9e5,
  faceDirection,
  faceOf,
  filterStack,
  LEVEL_SIDE,
  reduced,
  ROUGHNESS,
  summed,
  type Cube,
} from "../src/scene/environment";
import { unpackRows } from "../src/scene/factors";
import type { Client } from "../src/protocol/client";
import { lightMessages, onlyTurned } from "../src/scene/lights";
import {
  albedo,
  fromColor,
  holdsAnyEta,
  meanTransmittance,
  mediumText,
  parseMedium,
  toColor,
} from "../src/state/material";
import { FIRST, FIRST_LAMP, type SceneState } from "../src/state/scene-state";
import { fromFragment, toFragment } from "../src/state/url";

const even = (n: number, value = 1): Cube => ({
  n,
  texel: new Float32Array(18 * n * n).fill(value),
});
/** One texel lit in a direction. */
function spot(n: number, d: Vec3): Cube {
  const cube = even(n, 0);
  const [face, s, t] = faceOf(...d);
  const x = Math.floor((s * 0.5 + 0.5) * n);
  const y = Math.floor((t * 0.5 + 0.5) * n);
  cube.texel.fill(1, ((face * n + y) * n + x) * 3, ((face * n + y) * n + x) * 3 + 3);
  return cube;
}
function brightest(cube: Cube): Vec3 {
  let at = 0;
  cube.texel.forEach((x, i) => {
    if (x > (cube.texel[at] ?? 0)) at = i;
  });
  const i = Math.floor(at / 3);
  const { n } = cube;
  return faceDirection(
    Math.floor(i / (n * n)),
    (2 * (i % n) + 1) / n - 1,
    (2 * (Math.floor(i / n) % n) + 1) / n - 1,
  );
}
const dot = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

describe("cubes", () => {
  test("RGB9E5 decodes as PROTOCOL.md says", () => {
    const words = new Uint32Array([(256 | (128 << 9) | (64 << 18) | (16 << 27)) >>> 0]);
    expect([...decodeRgb9e5(words)]).toEqual([1, 0.5, 0.25]);
  });
  test("faces and directions are inverse", () => {
    for (let face = 0; face < 6; face++)
      for (const [s, t] of [
        [0.3, -0.7],
        [-0.9, 0.2],
      ] as const) {
        const [f, a, b] = faceOf(...faceDirection(face, s, t));
        expect(f).toBe(face);
        expect(a).toBeCloseTo(s, 6);
        expect(b).toBeCloseTo(t, 6);
      }
  });
  test("a turn is counter-clockwise seen from above: +x goes to -z at 90 degrees", () => {
    const lamp = {
      cube: spot(32, [1, 0, 0]),
      rotateDeg: 90,
      tiltDeg: 0,
      gain: [1, 1, 1] as Vec3,
    };
    expect(dot(brightest(summed([lamp], 32)), [0, 0, -1])).toBeGreaterThan(0.99);
  });
  test("a tilt lifts light from behind, and then the turn is applied", () => {
    const lamp = {
      cube: spot(32, [0, 0, -1]),
      rotateDeg: 0,
      tiltDeg: 40,
      gain: [1, 1, 1] as Vec3,
    };
    const up = brightest(summed([lamp], 32));
    expect(Math.abs(up[1])).toBeGreaterThan(0.5);
    const turned = brightest(summed([{ ...lamp, rotateDeg: 90 }], 32));
    expect(turned[1]).toBeCloseTo(up[1], 1);
  });
  test("lamps add, and gains multiply", () => {
    const lamp = (gain: Vec3) => ({ cube: even(16), rotateDeg: 10, tiltDeg: 5, gain });
    const { texel } = summed([lamp([1, 2, 3]), lamp([1, 0, 0])], 8);
    expect(texel[0]).toBeCloseTo(2, 4);
    expect(texel[1]).toBeCloseTo(2, 4);
    expect(texel[2]).toBeCloseTo(3, 4);
  });
  test("an even lamp keeps its radiance, still or turned, of any size", () => {
    for (const n of [16, 32, 64])
      for (const rotateDeg of [0, 33]) {
        const lamp = { cube: even(n), rotateDeg, tiltDeg: 0, gain: [1, 2, 3] as Vec3 };
        const { texel } = summed([lamp], 32);
        texel.forEach((x, i) => {
          if (Math.abs(x - 1 - (i % 3)) > 1e-4) expect(x).toBe(1 + (i % 3));
        });
      }
  });
  test("reduction keeps power", () => {
    const cube = spot(32, [0.2, 0.9, 0.1]);
    const power = ({ n, texel }: Cube) => {
      let sum = 0;
      for (let i = 0; i < 6 * n * n; i++) {
        const s = (2 * (i % n) + 1) / n - 1;
        const t = (2 * (Math.floor(i / n) % n) + 1) / n - 1;
        sum += ((texel[3 * i] ?? 0) * (1 + s * s + t * t) ** -1.5 * 4) / (n * n);
      }
      return sum;
    };
    expect(power(reduced(cube, 8)) / power(cube)).toBeCloseTo(1, 1);
  });
  test("the filter of reflections keeps even light, and blurs more with roughness", () => {
    const m = LEVEL_SIDE + 2;
    const stack = filterStack(even(LEVEL_SIDE, 0.5));
    for (let i = 0; i < stack.length; i += 4)
      expect(Math.abs((stack[i] ?? 0) - 0.5)).toBeLessThan(1e-4);
    const peaks = filterStack(spot(LEVEL_SIDE, [0, 0, 1]));
    const level = 6 * m * m * 4;
    const most = ROUGHNESS.map((_, k) => {
      let best = 0;
      for (let i = k * level; i < (k + 1) * level; i += 4) best = Math.max(best, peaks[i] ?? 0);
      return best;
    });
    for (let k = 1; k < most.length; k++) expect(most[k]).toBeLessThan(most[k - 1] ?? 0);
  });
  test("borders repeat what lies across the edge", () => {
    const n = 4;
    const texel = new Float32Array(18 * n * n);
    for (let i = 0; i < texel.length; i++) texel[i] = Math.floor(i / (3 * n * n)); // the face
    const edge = bordered({ n, texel });
    // Left of +Z (face 4) lies -X (face 1).
    expect(edge[((4 * (n + 2) + 2) * (n + 2) + 0) * 4]).toBe(1);
  });
  test("lights of the page are positive and finite", () => {
    for (const light of BUILTIN_LIGHTS) {
      const cube = builtinCube(`page:${light.id}`, 16);
      expect(cube?.texel.every((x) => x >= 0 && Number.isFinite(x))).toBe(true);
    }
    expect(builtinCube("page:none")).toBeNull();
  });
});

describe("camera", () => {
  const frame = frameOf(new Float32Array([-1, -2, -3, 1, 2, 3]), () => true);
  test("azimuth 90 looks along -x, as --orbit of prt", () => {
    const at = place(frame, { ...START, azimuth: 90, elevation: 0 }, 1);
    expect(at.eye[0]).toBeGreaterThan(5);
    expect(at.eye[2]).toBeCloseTo(0, 9);
  });
  test("the distance stays while it orbits, and zoom narrows the field of view", () => {
    const distance = (azimuth: number) => {
      const { eye, target } = place(frame, { ...START, azimuth }, 1.5);
      return Math.hypot(eye[0] - target[0], eye[1] - target[1], eye[2] - target[2]);
    };
    expect(distance(0)).toBeCloseTo(distance(123), 9);
    expect(place(frame, { ...START, zoom: 2 }, 1).fovyDeg).toBeCloseTo(
      (2 * Math.atan(Math.tan(Math.PI / 10) / 2) * 180) / Math.PI,
      6,
    );
  });
  test("orbits are kept in range", () => {
    const orbit = clampOrbit({ azimuth: -10, elevation: 200, zoom: 1e9, panX: 9, panY: -9 });
    expect(orbit).toEqual({ azimuth: 350, elevation: 89, zoom: 12, panX: 2, panY: -2 });
  });
});

describe("the link", () => {
  const scene: SceneState = {
    model: "a bunny & more #1.prt",
    lamps: [
      { env: `env:${"0a".repeat(32)}`, rotate: 33.5, tilt: -12, gain: [1, 0.5, 0.25] },
      { env: "constant:1,2,3", rotate: 0, tilt: 0, gain: [1, 1, 1] },
    ],
    material: '{"sigma_s_prime":[1,2,3],"sigma_a":[0.1,0.2,0.3],"g":0}',
    materials: { Left: "skin1", "a b": '{"g":0}' },
    variant: "night & day",
    term: "multiple",
    exposure: -1.25,
    tone: "none",
    background: [0.1, 0.2, 0.3],
    orbit: { azimuth: 12.5, elevation: -30, zoom: 2, panX: 0.5, panY: -0.25 },
    compare: null,
  };
  test("holds the whole scene", () => {
    expect(fromFragment(`#${toFragment(scene)}`)).toEqual(scene);
    expect(fromFragment(toFragment(FIRST))).toEqual(FIRST);
    const lit: SceneState = { ...FIRST, background: "environment", heat: "error" };
    expect(fromFragment(toFragment(lit))).toEqual(lit);
    const both: SceneState = { ...FIRST, compare: { mode: "wipe", at: 0.25, other: scene } };
    expect(fromFragment(toFragment(both))).toEqual(both);
  });
  test("a curve of 256 radii is whole", () => {
    const numbers = Array.from({ length: 256 }, (_, i) => 1 / (i + 3));
    const material = JSON.stringify({
      profile: "curve",
      radius: numbers,
      rd: [numbers, numbers, numbers],
    });
    const scene = { ...FIRST, material, materials: { Left: material } };
    expect(fromFragment(toFragment(scene))).toEqual(scene);
  });
  test("a link keeps the colour of a weak light", () => {
    const gain: [number, number, number] = [0.015625, 0.0015625, 0.00078125];
    const back = fromFragment(toFragment({ ...FIRST, lamps: [{ ...FIRST_LAMP, gain }] }));
    back.lamps[0]?.gain.forEach((x, i) => expect(x / (gain[i] ?? 1)).toBeCloseTo(1, 3));
  });
  test("lights are kept in range", () => {
    const lamp = (text: string) => fromFragment(`light=${text}`).lamps[0];
    expect(lamp("constant@10,500")).toMatchObject({ rotate: 10, tilt: 90, gain: [1, 1, 1] });
    expect(lamp("constant@10,-91")).toMatchObject({ tilt: -90 });
    expect(lamp("constant@0,0,-1,1e9,0.5")).toMatchObject({ gain: [0, 1e6, 0.5] });
    expect(lamp("constant@0,90")).toMatchObject({ tilt: 90 });
    expect(fromFragment("light=constant&".repeat(9)).lamps).toHaveLength(8);
  });
  test("unreadable words take their defaults", () => {
    const odd = fromFragment(
      "#light=javascript:1@2,3&orbit=a,b,c&ev=1e99&term=x&background=1,2&tone=",
    );
    expect(odd).toEqual({ ...FIRST, exposure: 40 });
    expect(fromFragment("#compare=wipe@x").compare).toBeNull();
    expect(fromFragment("#compare=none@0.5&other=").compare).toBeNull();
    expect(fromFragment("#compare=side@7&other=ev%3D2").compare).toEqual({
      mode: "side",
      at: 1,
      other: { ...FIRST, exposure: 2 },
    });
  });
  test("a turn needs no new texels, a tilt does", () => {
    expect(onlyTurned([FIRST_LAMP], [{ ...FIRST_LAMP, rotate: 5, gain: [2, 2, 2] }])).toBe(
      true,
    );
    expect(onlyTurned([FIRST_LAMP], [{ ...FIRST_LAMP, tilt: 5 }])).toBe(false);
    expect(onlyTurned([FIRST_LAMP], [FIRST_LAMP, FIRST_LAMP])).toBe(false);
  });
});

test("the texels of lights that the daemon cannot name follow each other", async () => {
  const nobody = {} as Client; // nothing is fetched
  const lamps: SceneState["lamps"] = [
    { env: "page:studio", rotate: 70, tilt: 30, gain: [1, 0.5, 0.25] },
    { env: "constant", rotate: 10, tilt: 0, gain: [2, 2, 2] },
    { env: "constant:3,2,1", rotate: 0, tilt: 5, gain: [9, 9, 9] },
  ];
  const { lights, payload } = await lightMessages(nobody, lamps);
  expect(lights).toEqual([
    { env: "", cubeN: 32, rotateDeg: 70, gain: { x: 1, y: 0.5, z: 0.25 } },
    { env: "constant", cubeN: 0, rotateDeg: 10, gain: { x: 2, y: 2, z: 2 } },
    { env: "", cubeN: 32, rotateDeg: 0, gain: { x: 9, y: 9, z: 9 } },
  ]);
  const texels = new Float32Array(payload.buffer);
  const one = 18 * 32 * 32;
  expect(texels.length).toBe(2 * one);
  // The turn and the gain are the daemon's, the tilt is in the texels.
  [3, 2, 1].forEach((x, c) => expect(texels[one + c]).toBeCloseTo(x, 4));
  const level = await lightMessages(nobody, [{ ...FIRST_LAMP }]);
  const same = (other: Uint8Array) => level.payload.every((x, i) => x === other[i]);
  expect(same(payload)).toBe(false);
  const turned = await lightMessages(nobody, [{ ...FIRST_LAMP, rotate: 90, gain: [0, 0, 0] }]);
  expect(same(turned.payload)).toBe(true);
});

describe("media", () => {
  test("the mean transmittance is that of METHODS §9", () => {
    expect(meanTransmittance(1.3)).toBeCloseTo(0.938868, 4);
    expect(meanTransmittance(1.5)).toBeCloseTo(0.908222, 4);
  });
  test("a bake's settings say whether it is for any refractive index", () => {
    expect(holdsAnyEta('{"any_eta":true}')).toBe(true);
    for (const not of ["", "{", "null", "{}", '{"any_eta":1}'])
      expect(holdsAnyEta(not)).toBe(false);
  });

  test("presets and JSON are read, and written again", () => {
    const marble = parseMedium("marble");
    expect(marble?.sigmaSPrime).toEqual([2.19, 2.62, 3]);
    expect(marble && parseMedium(mediumText(marble))).toEqual(marble);
    expect(parseMedium('{"profile":"burley"}')).toBeNull();
    expect(parseMedium("{")).toBeNull();
  });
  test("colour and free path come back from the medium they make", () => {
    const marble = parseMedium("marble");
    if (!marble) throw new Error("no marble");
    const made = toColor(fromColor([0.8, 0.5, 0.2], [1, 2, 4], marble));
    made.color.forEach((x, c) => expect(x).toBeCloseTo([0.8, 0.5, 0.2][c] ?? 0, 5));
    made.freePath.forEach((x, c) => expect(x).toBeCloseTo([1, 2, 4][c] ?? 0, 9));
  });
  test("albedo grows with reduced albedo from 0 to 1", () => {
    expect(albedo(0, 1, 1.3)).toBe(0);
    expect(albedo(1, 0, 1.3)).toBeCloseTo(1, 9);
    expect(albedo(0.9, 0.1, 1.3)).toBeGreaterThan(albedo(0.8, 0.2, 1.3));
  });
});

// The numbers of the protocol's vector coefficients_packed_answer, and the ends of the range.
test("packed coefficients become halves", () => {
  const packed = new Uint32Array([
    (2 << 30) | (64 << 20) | (128 << 10) | 256,
    (1024 - 512) | (0 << 30),
    (0 << 30) | (0 << 10),
    (1 << 30) | (256 << 10),
    (3 << 30) | (511 << 20) | (513 << 10),
    (3 << 30) | 1,
    1,
    0,
  ]);
  const numbers = Array.from(unpackRows(packed), (half) => DataUtils.fromHalfFloat(half));
  expect(numbers).toEqual([
    ...[2, 1, 0.5],
    ...[-4, 0, 0],
    ...[0, 0, 0],
    ...[0, 8, 0],
    ...[0, -511 * 64, 511 * 64],
    ...[64, 0, 0],
    ...[2 ** -9, 0, 0],
    ...[0, 0, 0],
  ]);
});
