// SPDX-License-Identifier: MIT
// A scene as the fragment of a URL, and back. Words that are missing or unreadable take their
// defaults, so that a link of another version still opens.
import { clampOrbit, START, type Vec3 } from "../scene/camera";
import {
  HEATS,
  COMPARE_MODES,
  FIRST,
  FIRST_LAMP,
  TERMS,
  TONES,
  type Comparison,
  type LampState,
  type SceneState,
} from "./scene-state";

// As a room's scene may have them.
const MOST_GAIN = 1e6;
const MOST_EV = 40;

const round = (x: number, digits = 2) => Number(x.toFixed(digits));
const list = (values: readonly number[], digits = 2) =>
  values.map((x) => round(x, digits)).join(",");

function numbers(text: string | null, n: number): number[] | null {
  const values = (text ?? "").split(",").map((word) => (word.trim() ? Number(word) : NaN));
  return values.length === n && values.every(Number.isFinite) ? values : null;
}
function number(text: string | null, otherwise: number, least: number, most: number): number {
  const [x] = numbers(text, 1) ?? [];
  return x === undefined ? otherwise : Math.min(most, Math.max(least, x));
}
function word<T extends string>(text: string | null, words: readonly T[], otherwise: T): T {
  return words.find((one) => one === text) ?? otherwise;
}

// ENV@ROTATE,TILT[,R,G,B]
function lampText(lamp: LampState): string {
  const gain = lamp.gain.every((x) => x === 1) ? [] : lamp.gain;
  const digits = gain.map((x) => String(Number(x.toPrecision(5)))); // weak lights keep their colour
  return `${lamp.env}@${[list([lamp.rotate, lamp.tilt], 3), ...digits].join(",")}`;
}
function lampFrom(text: string): LampState | null {
  const at = text.lastIndexOf("@");
  const env = at < 0 ? text : text.slice(0, at);
  if (
    !/^(page:[a-z]+|env:[0-9a-f]{64}|constant(:[0-9.eE+-]+,[0-9.eE+-]+,[0-9.eE+-]+)?)$/.test(
      env,
    )
  )
    return null;
  const values =
    at < 0 ? [0, 0] : (numbers(text.slice(at + 1), 2) ?? numbers(text.slice(at + 1), 5));
  if (!values) return null;
  const [rotate = 0, tilt = 0, r = 1, g = 1, b = 1] = values;
  const gain = [r, g, b].map((x) => Math.min(MOST_GAIN, Math.max(0, x))) as Vec3;
  return { env, rotate, tilt: Math.min(90, Math.max(-90, tilt)), gain };
}

const MOST_MATERIAL = 65536; // bytes that the daemon takes: half a curve would be none

// material.OBJECT, as in the daemon's HTTP queries.
const MATERIAL_OF = "material.";
function materialsFrom(words: URLSearchParams): Record<string, string> {
  const entries = [...words]
    .filter(([name, text]) => name.startsWith(MATERIAL_OF) && text)
    .map(
      ([name, text]) =>
        [name.slice(MATERIAL_OF.length, 130), text.slice(0, MOST_MATERIAL)] as const,
    );
  return Object.fromEntries(entries.filter(([object]) => object).slice(0, 64));
}

// MODE@AT, and the other state as a fragment of its own
function comparisonFrom(mode: string | null, other: string | null): Comparison | null {
  const [word = "", at = ""] = (mode ?? "").split("@");
  const known = COMPARE_MODES.find((one) => one === word);
  if (!known || other === null) return null;
  return {
    mode: known,
    at: number(at, 0.5, 0, 1),
    other: { ...fromFragment(other), compare: null },
  };
}

function heatFrom(text: string | null): Pick<SceneState, "heat"> {
  const heat = HEATS.find((one) => one === text);
  return heat ? { heat } : {};
}

export function toFragment(scene: SceneState): string {
  const out = new URLSearchParams();
  if (scene.model) out.set("model", scene.model);
  for (const lamp of scene.lamps) out.append("light", lampText(lamp));
  if (scene.material) out.set("material", scene.material);
  for (const [object, text] of Object.entries(scene.materials))
    out.set(MATERIAL_OF + object, text);
  if (scene.variant) out.set("variant", scene.variant);
  if (scene.term !== FIRST.term) out.set("term", scene.term);
  if (scene.heat) out.set("heat", scene.heat);
  if (scene.exposure) out.set("ev", String(round(scene.exposure)));
  if (scene.tone !== FIRST.tone) out.set("tone", scene.tone);
  if (scene.background === "environment") out.set("background", "environment");
  else if (list(scene.background, 4) !== list(FIRST.background as Vec3, 4))
    out.set("background", list(scene.background, 4));
  const { azimuth, elevation, zoom, panX, panY } = scene.orbit;
  out.set("orbit", list([azimuth, elevation, zoom, ...(panX || panY ? [panX, panY] : [])], 3));
  if (scene.compare) {
    const { mode, at, other } = scene.compare;
    out.set("compare", `${mode}@${round(at, 3)}`);
    out.set("other", toFragment({ ...other, compare: null }));
  }
  // Commas, colons and at-signs may stand in a fragment as they are.
  return out.toString().replace(/%2C/g, ",").replace(/%3A/g, ":").replace(/%40/g, "@");
}

export function fromFragment(fragment: string): SceneState {
  const words = new URLSearchParams(fragment.replace(/^#/, ""));
  const lamps = words
    .getAll("light")
    .map(lampFrom)
    .filter((lamp) => lamp !== null)
    .slice(0, 8);
  const orbit = numbers(words.get("orbit"), 3) ?? numbers(words.get("orbit"), 5);
  const [azimuth = START.azimuth, elevation = START.elevation, zoom = 1, panX = 0, panY = 0] =
    orbit ?? [];
  const background = words.get("background");
  return {
    model: (words.get("model") ?? "").slice(0, 300),
    lamps: lamps.length ? lamps : [FIRST_LAMP],
    material: (words.get("material") ?? "").slice(0, MOST_MATERIAL),
    materials: materialsFrom(words),
    variant: (words.get("variant") ?? "").slice(0, 63),
    term: word(words.get("term"), TERMS, FIRST.term),
    ...heatFrom(words.get("heat")),
    exposure: number(words.get("ev"), 0, -MOST_EV, MOST_EV),
    tone: word(words.get("tone"), TONES, FIRST.tone),
    background:
      background === "environment"
        ? background
        : ((numbers(background, 3)?.map((x) => Math.max(0, x)) as Vec3 | undefined) ??
          FIRST.background),
    orbit: clampOrbit({ azimuth, elevation, zoom, panX, panY }),
    compare: comparisonFrom(words.get("compare"), words.get("other")),
  };
}
