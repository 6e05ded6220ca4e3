// SPDX-License-Identifier: MIT
import { create } from "@bufbuild/protobuf";
import { describe, expect, test } from "vitest";
import { CameraSchema, SceneSchema, ShadeSchema } from "../src/gen/relight_pb";
import { lightsOf, orbitOf, PARTS, placedOf, sceneOf, withParts } from "../src/room/convert";
import { FOVY, place, type Frame, type Orbit } from "../src/scene/camera";
import { FIRST, type SceneState, TERMS, TONES } from "../src/state/scene-state";

const HASH = `env:${"0a".repeat(32)}`;
const SHARED = new Map([["page:studio", HASH]]);
const FRAME: Frame = { centre: [3, -1, 2], radius: 4 };
const SIZE = { width: 640, height: 480 };
const SHOWN: SceneState = {
  ...FIRST,
  model: "m",
  lamps: [
    { env: "page:studio", rotate: 350, tilt: 0, gain: [1, 0.5, 0.25] },
    { env: "constant:1,2,3", rotate: 0, tilt: 0, gain: [1, 1, 1] },
  ],
  material: "marble",
  materials: { Left: "skin1", Right: "jade" },
  variant: "night",
  term: "single",
  exposure: -1.25,
  tone: "reinhard",
  background: [0.25, 0.5, 0.75],
};
const roundTrip = (state: SceneState, parts: readonly string[] = PARTS, base?: unknown) => {
  const init = sceneOf(state, state.model, null, lightsOf(state.lamps, SHARED) ?? [], SIZE);
  return withParts(
    (base as SceneState | undefined) ?? FIRST,
    create(SceneSchema, init),
    parts,
    SHARED,
  );
};

describe("a room's scene", () => {
  test("is the page's state, and back", () => {
    expect(roundTrip(SHOWN)).toEqual(SHOWN);
    for (const term of TERMS)
      for (const tone of TONES)
        expect(roundTrip({ ...SHOWN, term, tone })).toMatchObject({ term, tone });
    const lit: SceneState = { ...SHOWN, background: "environment" };
    expect(roundTrip(lit).background).toBe("environment");
  });
  test("changes the parts that are named, and no other", () => {
    const of = {
      model: ["model"],
      lights: ["lamps"],
      material: ["material"],
      shade: ["term", "materials", "variant"],
      picture: ["exposure", "tone", "background"],
    } as const;
    for (const [part, fields] of Object.entries(of)) {
      const wanted: Record<string, unknown> = { ...FIRST };
      for (const field of fields) wanted[field] = SHOWN[field];
      expect(roundTrip(SHOWN, [part])).toEqual(wanted);
    }
  });
  test("takes the model's own objects and variant back", () => {
    const plain = { ...SHOWN, materials: {}, variant: "", material: "" };
    expect(roundTrip(plain, PARTS, SHOWN)).toEqual(plain);
  });
  test("keeps what the page has no words for", () => {
    const shade = create(ShadeSchema, { maxError: 0.25, variant: "day", budgetMs: 7 });
    const base = create(SceneSchema, { shade });
    const init = sceneOf(SHOWN, "m", null, [], SIZE, base);
    expect(init.shade).toMatchObject({ maxError: 0.25, budgetMs: 7, variant: "night" });
  });
  test("has no lights while one of the page's was not uploaded", () => {
    expect(
      lightsOf([...SHOWN.lamps, { ...FIRST.lamps[0], env: "page:sun" } as never], SHARED),
    ).toBe(null);
  });
});

describe("the camera of a room", () => {
  const orbit: Orbit = { azimuth: 200, elevation: -35, zoom: 2.5, panX: 0.5, panY: -0.75 };
  test("is the orbit that placed it", () => {
    for (const one of [orbit, { ...orbit, azimuth: 20, elevation: 70, zoom: 0.5, panX: -1 }]) {
      const placed = place(FRAME, one, 1.5);
      const vec = (v: readonly number[]) => ({ x: v[0] ?? 0, y: v[1] ?? 0, z: v[2] ?? 0 });
      const camera = create(CameraSchema, {
        eye: vec(placed.eye),
        target: vec(placed.target),
        up: vec(placed.up),
        fovyDeg: placed.fovyDeg,
      });
      expect(placedOf(camera)).toEqual(placed);
      const found = orbitOf(camera, FRAME);
      for (const key of ["azimuth", "elevation", "zoom", "panX", "panY"] as const)
        expect(found?.[key]).toBeCloseTo(one[key], 4);
      expect(sceneOf(SHOWN, "m", placed, [], SIZE).camera).toMatchObject({
        up: camera.up,
        target: camera.target,
        fovyDeg: camera.fovyDeg,
      });
    }
  });
  test("may say an orbit, or leave its angle out", () => {
    const said = create(CameraSchema, {
      orbit: { azimuthDeg: -10, elevationDeg: 20, zoom: 0 },
    });
    expect(orbitOf(said, FRAME)).toEqual({
      azimuth: 350,
      elevation: 20,
      zoom: 1,
      panX: 0,
      panY: 0,
    });
    expect(placedOf(said)).toBeNull();
    const eye = create(CameraSchema, { eye: { x: 9, y: 0, z: 0 } });
    expect(placedOf(eye)).toMatchObject({ fovyDeg: FOVY, up: [0, 1, 0], target: [0, 0, 0] });
    expect(orbitOf(eye, FRAME)).toMatchObject({ azimuth: 90, zoom: 1 });
    expect(orbitOf(create(CameraSchema, { name: "front" }), FRAME)).toBeNull();
  });
});
