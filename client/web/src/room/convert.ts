// SPDX-License-Identifier: MIT
// A room's Scene as the page's state, and back.
import { create, type MessageInitShape } from "@bufbuild/protobuf";
import {
  CameraSchema,
  LightSchema,
  ObjectMaterialSchema,
  PictureSchema,
  ShadeSchema,
  Term as TermValue,
  type Camera,
  type Scene,
  type SceneSchema,
} from "../gen/relight_pb";
import {
  clampOrbit,
  FOVY,
  type Frame,
  type Orbit,
  type Placed,
  type Vec3,
} from "../scene/camera";
import { TERMS, TONES, type LampState, type SceneState, type Term } from "../state/scene-state";

export type SceneInit = MessageInitShape<typeof SceneSchema>;
export const PARTS = ["model", "lights", "material", "shade", "camera", "picture"] as const;
export type PartName = (typeof PARTS)[number];

const DEGREE = Math.PI / 180;
const vec = (v: Vec3) => ({ x: v[0], y: v[1], z: v[2] });
const triple = (v: { x: number; y: number; z: number } | undefined, missing: Vec3): Vec3 =>
  v ? [v.x, v.y, v.z] : missing;
const dot = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const less = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

const NUMBERS: Record<Term, TermValue> = {
  total: TermValue.TOTAL,
  irradiance: TermValue.IRRADIANCE,
  multiple: TermValue.MULTIPLE,
  single: TermValue.SINGLE,
};

/** The environments that the daemon has in place of the page's own: "page:ID" to "env:HASH". */
export type Shared = ReadonlyMap<string, string>;

/** Null where a light is one of the page's that was not uploaded yet. */
export function lightsOf(
  lamps: readonly LampState[],
  shared: Shared,
): SceneInit["lights"] | null {
  const envs = lamps.map((lamp) =>
    lamp.env.startsWith("page:") ? shared.get(lamp.env) : lamp.env,
  );
  if (envs.some((env) => env === undefined)) return null;
  return lamps.map((lamp, i) =>
    create(LightSchema, {
      env: envs[i] ?? "",
      rotateDeg: Math.fround(lamp.rotate),
      gain: vec(lamp.gain),
    }),
  );
}

/** A scene of a room. What the page has no words for (an engine, images over the model's uv) stays
 * as `base` has it. */
export function sceneOf(
  state: SceneState,
  model: string,
  placed: Placed | null,
  lights: SceneInit["lights"],
  size: { width: number; height: number },
  base?: Scene,
): SceneInit {
  const materials = Object.entries(state.materials).map(([object, material]) =>
    create(ObjectMaterialSchema, { object, material }),
  );
  return {
    model,
    lights,
    material: state.material,
    shade: {
      ...(base?.shade ?? create(ShadeSchema)),
      term: NUMBERS[state.term],
      materials,
      variant: state.variant,
    },
    camera: placed
      ? create(CameraSchema, {
          eye: vec(placed.eye),
          target: vec(placed.target),
          up: vec(placed.up),
          fovyDeg: placed.fovyDeg,
        })
      : undefined,
    picture: create(PictureSchema, {
      ...size,
      tone: TONES.indexOf(state.tone),
      exposureEv: state.exposure,
      plainBackground: state.background !== "environment",
      background: state.background === "environment" ? undefined : vec(state.background),
    }),
  };
}

/** A camera that says where its eye is; null for others. */
export function placedOf(camera: Camera | undefined): Placed | null {
  if (!camera?.eye || camera.orbit) return null;
  return {
    eye: triple(camera.eye, [0, 0, 1]),
    target: triple(camera.target, [0, 0, 0]),
    up: triple(camera.up, [0, 1, 0]),
    fovyDeg: camera.fovyDeg || FOVY,
  };
}

/** The orbit of a camera, given what it frames; null where the page cannot show it. */
export function orbitOf(camera: Camera | undefined, frame: Frame): Orbit | null {
  if (camera?.orbit) {
    const { azimuthDeg, elevationDeg, zoom } = camera.orbit;
    return clampOrbit({
      azimuth: azimuthDeg,
      elevation: elevationDeg,
      zoom: zoom || 1,
      panX: 0,
      panY: 0,
    });
  }
  if (!camera?.eye) return null;
  const target = triple(camera.target, [0, 0, 0]);
  const back = less(triple(camera.eye, [0, 0, 1]), target);
  const length = Math.hypot(...back);
  if (!(length > 0)) return null;
  const elevation = Math.asin(Math.min(1, Math.max(-1, back[1] / length)));
  const azimuth = Math.atan2(back[0], back[2]);
  const [sa, ca, se, ce] = [
    Math.sin(azimuth),
    Math.cos(azimuth),
    Math.sin(elevation),
    Math.cos(elevation),
  ];
  const shift = less(target, frame.centre);
  const fovy = camera.fovyDeg || FOVY;
  return clampOrbit({
    azimuth: azimuth / DEGREE,
    elevation: elevation / DEGREE,
    zoom: Math.tan((FOVY * DEGREE) / 2) / Math.tan((fovy * DEGREE) / 2),
    panX: dot(shift, [ca, 0, -sa]) / frame.radius,
    panY: dot(shift, [-sa * se, ce, -ca * se]) / frame.radius,
  });
}

/** The page's state with these parts of a room's scene; the camera follows by orbitOf. */
export function withParts(
  state: SceneState,
  scene: Scene,
  parts: readonly string[],
  shared: Shared,
): SceneState {
  const out = { ...state };
  const own = new Map([...shared].map(([page, env]) => [env, page]));
  if (parts.includes("model") && scene.model) out.model = scene.model;
  if (parts.includes("lights") && scene.lights.length)
    out.lamps = scene.lights.map((light) => ({
      env: own.get(light.env) ?? light.env,
      rotate: ((light.rotateDeg % 360) + 360) % 360,
      tilt: 0,
      gain: triple(light.gain, [1, 1, 1]),
    }));
  if (parts.includes("material")) out.material = scene.material;
  if (parts.includes("shade")) {
    const number = scene.shade?.term ?? TermValue.TOTAL;
    out.term = TERMS.find((word) => NUMBERS[word] === number) ?? "total";
    const own = scene.shade?.materials.map(({ object, material }) => [object, material]) ?? [];
    out.materials = Object.fromEntries(own) as Record<string, string>;
    out.variant = scene.shade?.variant ?? "";
  }
  const { picture } = scene;
  if (parts.includes("picture") && picture) {
    out.exposure = picture.exposureEv;
    out.tone = TONES[picture.tone] ?? "filmic";
    out.background = picture.plainBackground
      ? triple(picture.background, [0, 0, 0])
      : "environment";
  }
  return out;
}

export const sameJson = (a: unknown, b: unknown) =>
  JSON.stringify(a, (_, x: unknown) => (typeof x === "bigint" ? String(x) : x)) ===
  JSON.stringify(b, (_, x: unknown) => (typeof x === "bigint" ? String(x) : x));
