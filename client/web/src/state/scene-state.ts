// SPDX-License-Identifier: MIT
// Everything that a picture depends on. A link holds it, undo steps through it.
import type { Orbit, Vec3 } from "../scene/camera";
import { START } from "../scene/camera";

export interface LampState {
  /** "page:studio" (scene/builtin-lights.ts), "env:HASH", "constant" or "constant:R,G,B". */
  env: string;
  /** Degrees about +y, counter-clockwise seen from above. */
  rotate: number;
  /** Degrees about the environment's x axis. */
  tilt: number;
  /** Factors of red, green and blue. */
  gain: Vec3;
}
export type Term = "total" | "multiple" | "single" | "irradiance";
export const TERMS: readonly Term[] = ["total", "multiple", "single", "irradiance"];
export type Heat = "thickness" | "error" | "dipole";
export const HEATS: readonly Heat[] = ["thickness", "error", "dipole"];
export type Tone = "filmic" | "reinhard" | "none";
export const TONES: readonly Tone[] = ["filmic", "reinhard", "none"];
/** "environment", or linear RGB. */
export type Background = "environment" | Vec3;

export type CompareMode = "side" | "wipe" | "difference";
export const COMPARE_MODES: readonly CompareMode[] = ["side", "wipe", "difference"];
/** A second state, B, beside the scene, which is A. */
export interface Comparison {
  mode: CompareMode;
  /** Where the wipe stands, from the left; in [0, 1]. */
  at: number;
  /** Its own comparison is null, and its camera is not used. */
  other: SceneState;
}

export interface SceneState {
  /** Id or name; empty: none is chosen. */
  model: string;
  lamps: LampState[];
  /** Preset or JSON; empty: the model's own. Of the objects that `materials` does not name. */
  material: string;
  /** Presets or JSON by object, a glTF material or node. */
  materials: Readonly<Record<string, string>>;
  /** One of the model's variants; empty: the one that it was loaded with. */
  variant: string;
  term: Term;
  /** A quantity in place of light. */
  heat?: Heat;
  /** EV. */
  exposure: number;
  tone: Tone;
  background: Background;
  orbit: Orbit;
  compare: Comparison | null;
}

export const FIRST_LAMP: LampState = {
  env: "page:studio",
  rotate: 0,
  tilt: 0,
  gain: [1, 1, 1],
};
export const FIRST: SceneState = {
  model: "",
  lamps: [FIRST_LAMP],
  material: "",
  materials: {},
  variant: "",
  term: "total",
  exposure: 0,
  tone: "filmic",
  background: [0.018, 0.019, 0.022],
  orbit: START,
  compare: null,
};
