// SPDX-License-Identifier: MIT
// Where a bake errs, or the dipole: errors at the vertices that were measured, between them
// interpolated over the surface, as colours in place of light.
import {
  BufferAttribute,
  DoubleSide,
  GLSL3,
  Mesh as ThreeMesh,
  RawShaderMaterial,
  Scene,
  type BufferGeometry,
  type PerspectiveCamera,
  type WebGLRenderer,
} from "three";
import { HEAT } from "./thickness";

/** Errors of a bake at vertices of GEOMETRY, each relative to the model's mean brightness. */
export interface ErrorPlaces {
  vertex: readonly number[];
  error: readonly number[];
}

/** The dipole's multiple scattering under an even sky against random walks. */
export interface DipoleError {
  /** RMS error of the dipole, relative. */
  rms: number;
  /** Dipole over walks, less 1: what one vertex in fifty exceeds, and at vertices. */
  darkest: number;
  brightest: number;
  places: ErrorPlaces;
}

interface Errors {
  places?: { vertex?: unknown; error?: unknown };
  dipole?: { sky?: unknown; darkest?: unknown; brightest?: unknown; ratio?: unknown };
}

function parse(errors: string): Errors {
  try {
    return (JSON.parse(errors || "{}") as Errors | null) ?? {};
  } catch {
    return {};
  }
}

function placesWith(vertex: unknown, error: unknown, nVertex: number, least: number) {
  if (!Array.isArray(vertex) || !Array.isArray(error)) return null;
  if (!vertex.length || vertex.length !== error.length) return null;
  const good =
    vertex.every((v) => Number.isInteger(v) && v >= 0 && v < nVertex) &&
    error.every((e) => Number.isFinite(e) && e >= least);
  return good ? { vertex: vertex as number[], error: error as number[] } : null;
}

/** ModelInfo.errors' places; null: an older bake, or none. */
export function placesOf(errors: string, nVertex: number): ErrorPlaces | null {
  const { places } = parse(errors);
  return placesWith(places?.vertex, places?.error, nVertex, 0);
}

/** Whether ModelInfo.settings is of a bake by random walks. */
export function isByWalks(settings: string): boolean {
  try {
    return (JSON.parse(settings) as { scattering?: unknown }).scattering === "walk";
  } catch {
    return false;
  }
}

/** The dipole's error in ModelInfo.errors; null: the bake was not compared with walks. */
export function dipoleErrorOf(errors: string, nVertex: number): DipoleError | null {
  const { places, dipole } = parse(errors);
  const at = placesWith(places?.vertex, dipole?.ratio, nVertex, -1);
  const { sky, darkest, brightest } = dipole ?? {};
  if (!at || typeof sky !== "number") return null;
  if (typeof darkest !== "number" || typeof brightest !== "number") return null;
  return { rms: sky, darkest, brightest, places: at };
}

const NEAREST = 4;

/** The error at each of the points [n][3]: the mean of the nearest places, weighted by one over the
 * squared distance. at: positions of the places, [k][3]. */
export function spread(points: ArrayLike<number>, at: Float32Array, error: readonly number[]) {
  const n = points.length / 3;
  const out = new Float32Array(n);
  const near = Math.min(NEAREST, error.length);
  const distance = new Float64Array(near);
  const value = new Float64Array(near);
  for (let i = 0; i < n; i++) {
    const [x = 0, y = 0, z = 0] = [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
    distance.fill(Infinity);
    error.forEach((e, k) => {
      const dx = (at[3 * k] ?? 0) - x;
      const dy = (at[3 * k + 1] ?? 0) - y;
      const dz = (at[3 * k + 2] ?? 0) - z;
      const d = dx * dx + dy * dy + dz * dz;
      let slot = near - 1;
      if (d >= (distance[slot] ?? 0)) return;
      for (; slot > 0 && d < (distance[slot - 1] ?? 0); slot--) {
        distance[slot] = distance[slot - 1] ?? 0;
        value[slot] = value[slot - 1] ?? 0;
      }
      distance[slot] = d;
      value[slot] = e;
    });
    let sum = 0;
    let weights = 0;
    for (let k = 0; k < near; k++) {
      const weight = 1 / Math.max(distance[k] ?? 0, 1e-20);
      sum += weight * (value[k] ?? 0);
      weights += weight;
    }
    out[i] = sum / weights;
  }
  return out;
}

const vertexShader = /* glsl */ `
precision highp float;
uniform mat4 modelViewMatrix, projectionMatrix;
in vec3 position, normal;
in float bakeError;
out float error, facing;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  vec3 n = normalize(mat3(modelViewMatrix) * normal);
  error = bakeError;
  facing = abs(dot(n, normalize(seen.xyz)));
  gl_Position = projectionMatrix * seen;
}`;
// Edges are darker, so that the shape is seen.
const fragmentShader = /* glsl */ `
precision highp float;
uniform float most;
in float error, facing;
out vec4 color;
${HEAT}
// White: equal; red: too bright, blue: too dark, full at a factor of two.
vec3 ratio(float excess) {
  float t = clamp(log2(max(1.0 + excess, 0.5)), -1.0, 1.0);
  return vec3(1.0) - (t > 0.0 ? vec3(0.0, t, t) : vec3(-t, -t, 0.0));
}
void main() {
  vec3 shown = most > 0.0 ? heat(error / most) : ratio(error);
  color = vec4(shown * (0.55 + 0.45 * facing), 1.0);
}`;

export class ErrorMap {
  private readonly material = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader,
    fragmentShader,
    side: DoubleSide,
    uniforms: { most: { value: 1 } },
  });
  private readonly scene = new Scene();
  private parts: readonly BufferGeometry[] = [];

  /** Geometries of the translucent parts, which share their attributes. */
  setParts(parts: readonly BufferGeometry[]): void {
    this.parts = parts;
    this.scene.clear();
    for (const part of parts) {
      const drawn = new ThreeMesh(part, this.material);
      drawn.frustumCulled = false;
      this.scene.add(drawn);
    }
  }

  /** The error that is drawn brightest; 0: errors are ratios less 1. */
  setMost(most: number): void {
    const { most: uniform } = this.material.uniforms;
    if (uniform) uniform.value = most;
  }

  /** positions: of the mesh whose vertices the places name. */
  setErrors(places: ErrorPlaces, positions: Float32Array): void {
    const points = this.parts[0]?.getAttribute("position").array;
    if (!points) return;
    const at = Float32Array.from(
      places.vertex.flatMap((v) => Array.from(positions.subarray(3 * v, 3 * v + 3))),
    );
    const errors = new BufferAttribute(spread(points, at, places.error), 1);
    for (const part of this.parts) part.setAttribute("bakeError", errors);
  }

  draw(renderer: WebGLRenderer, camera: PerspectiveCamera): void {
    renderer.render(this.scene, camera);
  }

  dispose(): void {
    this.material.dispose();
  }
}
