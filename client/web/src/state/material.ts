// SPDX-License-Identifier: MIT
// Materials as the daemon takes them: presets by name and JSON; lengths in mm (PROTOCOL, COLORS).
import { PRESETS } from "../gen/presets";
import type { ModelInfo } from "../gen/relight_pb";

type Rgb = [number, number, number];
/** A dipole medium; mm⁻¹. */
export interface Medium {
  name: string;
  sigmaSPrime: Rgb;
  sigmaA: Rgb;
  g: Rgb;
  eta: number;
  roughness: number;
}
export const PRESET_NAMES: readonly string[] = PRESETS.map((preset) => preset.name);

function rgb(value: unknown): Rgb | null {
  if (typeof value === "number" && Number.isFinite(value)) return [value, value, value];
  if (!Array.isArray(value) || value.length !== 3) return null;
  const out = value.map(Number);
  return out.every(Number.isFinite) ? (out as Rgb) : null;
}

/** The medium of a text; null for texts without sigma (profiles of other kinds). */
export function parseMedium(text: string): Medium | null {
  const preset = PRESETS.find((one) => one.name === text.toLowerCase());
  if (preset) return { ...preset, g: [0, 0, 0] };
  let json: unknown;
  try {
    json = JSON.parse(text);
  } catch {
    return null;
  }
  if (typeof json !== "object" || json === null) return null;
  const fields = json as Record<string, unknown>;
  const sigmaSPrime = rgb(fields.sigma_s_prime);
  const sigmaA = rgb(fields.sigma_a);
  if (!sigmaSPrime || !sigmaA) return null;
  return {
    name: typeof fields.name === "string" ? fields.name : "",
    sigmaSPrime,
    sigmaA,
    g: rgb(fields.g ?? 0) ?? [0, 0, 0],
    eta: Number(fields.eta ?? 1.3),
    roughness: Number(fields.roughness ?? 0.3),
  };
}

/** The refractive indices of a joint bake for any (PROTOCOL, BakeSettings.any_eta). */
export const ANY_ETA = { min: 1.2, max: 1.6 } as const;
/** Whether ModelInfo.settings is of such a bake. */
export function holdsAnyEta(settings: string): boolean {
  try {
    return (JSON.parse(settings) as { any_eta?: unknown } | null)?.any_eta === true;
  } catch {
    return false;
  }
}

/** η and roughness of any material text. */
export function surfaceOf(text: string): { eta: number; roughness: number } {
  const medium = parseMedium(text);
  if (medium) return medium;
  try {
    const { eta, roughness } = JSON.parse(text) as { eta?: number; roughness?: number };
    return { eta: eta ?? 1.3, roughness: roughness ?? 0.3 };
  } catch {
    return { eta: 1.3, roughness: 0.3 };
  }
}

const digits = (x: number) => Number(x.toPrecision(4));
export function mediumText(medium: Medium): string {
  return JSON.stringify({
    ...(medium.name ? { name: medium.name } : {}),
    sigma_s_prime: medium.sigmaSPrime.map(digits),
    sigma_a: medium.sigmaA.map(digits),
    g: medium.g.every((x) => x === medium.g[0]) ? medium.g[0] : medium.g,
    eta: digits(medium.eta),
    roughness: digits(medium.roughness),
  });
}

/** Diffuse albedo of a half-space with reduced albedo a = σ_s'/(σ_s'+σ_a) (JMLH01 eq 15 integrated,
 * with A of the index). */
export function albedo(sigmaSPrime: number, sigmaA: number, eta: number): number {
  const a = sigmaSPrime / (sigmaSPrime + sigmaA || 1);
  const fdr = -1.44 / (eta * eta) + 0.71 / eta + 0.668 + 0.0636 * eta;
  const A = (1 + fdr) / (1 - fdr);
  const s = Math.sqrt(3 * (1 - a));
  return (a / 2) * (1 + Math.exp((-4 / 3) * A * s)) * Math.exp(-s);
}

/** A medium of this diffuse colour (albedo) and mean free path 1/σ_t' in mm: the inverse of
 * albedo(), by bisection. */
export function fromColor(color: Rgb, freePath: Rgb, like: Medium): Medium {
  const sigmaSPrime: Rgb = [0, 0, 0];
  const sigmaA: Rgb = [0, 0, 0];
  for (let c = 0; c < 3; c++) {
    const wanted = Math.min(0.995, Math.max(0.001, color[c] ?? 0.5));
    let lo = 0;
    let hi = 1;
    for (let i = 0; i < 50; i++) {
      const mid = (lo + hi) / 2;
      if (albedo(mid, 1 - mid, like.eta) < wanted) lo = mid;
      else hi = mid;
    }
    const sigmaT = 1 / Math.max(1e-3, freePath[c] ?? 1);
    sigmaSPrime[c] = lo * sigmaT;
    sigmaA[c] = (1 - lo) * sigmaT;
  }
  return { ...like, name: "", sigmaSPrime, sigmaA };
}
export function toColor(medium: Medium): { color: Rgb; freePath: Rgb } {
  const each = (f: (s: number, a: number) => number) =>
    medium.sigmaSPrime.map((s, c) => f(s, medium.sigmaA[c] ?? 0)) as Rgb;
  return {
    color: each((s, a) => albedo(s, a, medium.eta)),
    freePath: each((s, a) => 1 / (s + a || 1)),
  };
}

/** Cosine-weighted mean of the Fresnel transmittance (METHODS §9). */
export function meanTransmittance(eta: number): number {
  const n = 400;
  let sum = 0;
  for (let i = 0; i < n; i++) {
    const c = (i + 0.5) / n;
    const t = Math.sqrt(1 - (1 - c * c) / (eta * eta));
    const rs = (c - eta * t) / (c + eta * t);
    const rp = (eta * c - t) / (eta * c + t);
    sum += 2 * c * (1 - (rs * rs + rp * rp) / 2);
  }
  return sum / n;
}

/** An object with a name that a map of media takes. */
export interface MediaObject {
  name: string;
  /** Into ModelInfo.media. */
  medium: number;
}
type Blocks = Pick<ModelInfo, "blocks"> | null;
/** glTF materials where they tell the translucent objects apart, else nodes; none for one object. */
export function mediaObjects(info: Blocks): MediaObject[] {
  const blocks = (info?.blocks ?? []).filter(({ translucent }) => translucent);
  const by = (key: "surface" | "node") => {
    const found = new Map<string, number>();
    for (const block of blocks)
      if (block[key] && !found.has(block[key])) found.set(block[key], block.medium);
    return [...found].map(([name, medium]) => ({ name, medium }));
  };
  const bySurface = by("surface");
  const found = bySurface.length > 1 ? bySurface : by("node");
  return found.length > 1 ? found : [];
}
