// SPDX-License-Identifier: MIT
// Thickness: how much of each line of sight lies inside the translucent parts, in mm. Distances of
// surfaces that face away count positive, of others negative; their sum is blended on the GPU.
import {
  type BufferGeometry,
  Camera,
  DataUtils,
  DoubleSide,
  GLSL3,
  HalfFloatType,
  Mesh as ThreeMesh,
  NearestFilter,
  RawShaderMaterial,
  RGBAFormat,
  Scene,
  Vector3,
  WebGLRenderTarget,
  type PerspectiveCamera,
  type WebGLRenderer,
} from "three";
import { ADDITIVE } from "./additive";
import { screenTriangle } from "./screen-triangle";

const vertex = /* glsl */ `
precision highp float;
uniform mat4 modelViewMatrix, projectionMatrix;
in vec3 position;
out vec3 at;
void main() {
  at = position;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
// Distances are counted from that of the centre, so that halves resolve them.
const fragment = /* glsl */ `
precision highp float;
uniform vec3 eye;
uniform float far, mm;
in vec3 at;
out vec4 sum;
void main() {
  float d = (distance(at, eye) - far) * mm;
  sum = vec4(gl_FrontFacing ? -d : d, gl_FrontFacing ? 1.0 : -1.0, 1.0, 1.0);
}`;
const screenVertex = /* glsl */ `
precision highp float;
in vec3 position;
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`;
/** Dark blue over green to yellow: the colour of a share in [0, 1]. */
export const HEAT = /* glsl */ `
vec3 heat(float share) {
  float x = clamp(share, 0.0, 1.0);
  vec3 low = vec3(0.10, 0.06, 0.33), middle = vec3(0.13, 0.57, 0.55), high = vec3(0.99, 0.91, 0.14);
  return x < 0.5 ? mix(low, middle, 2.0 * x) : mix(middle, high, 2.0 * x - 1.0);
}`;
// Red: the surface is open there, and the sum says nothing.
const screenFragment = /* glsl */ `
precision highp float;
uniform sampler2D sums;
uniform float most;
out vec4 color;
${HEAT}
void main() {
  vec4 s = texelFetch(sums, ivec2(gl_FragCoord.xy), 0);
  if (s.z < 0.5) discard;
  color = vec4(abs(s.y) > 0.5 ? vec3(0.8, 0.1, 0.1) : heat(s.x / most), 1.0);
}`;

export class Thickness {
  private readonly material = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: vertex,
    fragmentShader: fragment,
    side: DoubleSide,
    ...ADDITIVE,
    uniforms: { eye: { value: new Vector3() }, far: { value: 0 }, mm: { value: 1 } },
  });
  private readonly screen: RawShaderMaterial;
  private readonly scene = new Scene();
  private readonly all = new Scene();
  private target: WebGLRenderTarget | null = null;

  constructor() {
    this.screen = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: screenVertex,
      fragmentShader: screenFragment,
      depthTest: false,
      depthWrite: false,
      uniforms: { sums: { value: null }, most: { value: 1 } },
    });
    this.all.add(screenTriangle(this.screen));
  }

  /** Geometries of the translucent parts. */
  setParts(parts: readonly BufferGeometry[]): void {
    this.scene.clear();
    for (const part of parts) {
      const drawn = new ThreeMesh(part, this.material);
      drawn.frustumCulled = false;
      this.scene.add(drawn);
    }
  }

  /** Draws into what is bound. mostMm: the thickness that is drawn brightest. */
  draw(
    renderer: WebGLRenderer,
    into: WebGLRenderTarget | null,
    size: { width: number; height: number },
    view: { camera: PerspectiveCamera; eye: Vector3; far: number; mmPerUnit: number },
    mostMm: number,
  ): void {
    const old = this.target;
    if (old?.width !== size.width || old.height !== size.height) {
      old?.dispose();
      this.target = new WebGLRenderTarget(size.width, size.height, {
        type: HalfFloatType,
        format: RGBAFormat,
        minFilter: NearestFilter,
        magFilter: NearestFilter,
        depthBuffer: false,
      });
    }
    const u = this.material.uniforms;
    if (u.eye) u.eye.value = view.eye;
    if (u.far) u.far.value = view.far;
    if (u.mm) u.mm.value = view.mmPerUnit;
    renderer.setRenderTarget(this.target);
    renderer.clear();
    renderer.render(this.scene, view.camera);
    renderer.setRenderTarget(into);
    const s = this.screen.uniforms;
    if (s.sums) s.sums.value = this.target?.texture ?? null;
    if (s.most) s.most.value = mostMm;
    renderer.render(this.all, new Camera());
  }

  /** The thickness drawn last, in mm, bottom row first; NaN beside the model and where it is open. */
  read(renderer: WebGLRenderer): Float32Array {
    const { target } = this;
    if (!target) return new Float32Array(0);
    const sums = new Uint16Array(4 * target.width * target.height);
    renderer.readRenderTargetPixels(target, 0, 0, target.width, target.height, sums);
    const at = (i: number) => DataUtils.fromHalfFloat(sums[i] ?? 0);
    return Float32Array.from({ length: target.width * target.height }, (_, i) =>
      at(4 * i + 2) && !at(4 * i + 1) ? at(4 * i) : NaN,
    );
  }

  dispose(): void {
    this.target?.dispose();
    this.material.dispose();
    this.screen.dispose();
  }
}
