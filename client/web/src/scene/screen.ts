// SPDX-License-Identifier: MIT
// The targets that frames are drawn into on their way to the canvas: of four samples a pixel, or of
// half the width and height (frame-quality.ts).
import {
  Camera,
  GLSL3,
  LinearFilter,
  LinearSRGBColorSpace,
  RawShaderMaterial,
  Scene,
  WebGLRenderTarget,
  type WebGLRenderer,
} from "three";
import type { Quality } from "./frame-quality";
import { screenTriangle } from "./screen-triangle";

const vertex = /* glsl */ `
precision highp float;
in vec3 position;
out vec2 at;
void main() {
  at = 0.5 * position.xy + 0.5;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}`;
const fragment = /* glsl */ `
precision highp float;
uniform sampler2D picture;
in vec2 at;
out vec4 color;
void main() { color = texture(picture, at); }`;

export class Screen {
  private readonly targets: (WebGLRenderTarget | null)[] = [null, null, null];
  private readonly scene = new Scene();
  private readonly material = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: vertex,
    fragmentShader: fragment,
    depthTest: false,
    depthWrite: false,
    uniforms: { picture: { value: null } },
  });

  constructor() {
    this.scene.add(screenTriangle(this.material));
  }

  /** Where a frame of this quality is drawn; null: to the canvas itself. */
  target(
    quality: Quality,
    canvas: { width: number; height: number },
  ): WebGLRenderTarget | null {
    if (quality === 1) return null;
    const share = quality === 2 ? 0.5 : 1;
    const width = Math.max(1, Math.ceil(canvas.width * share));
    const height = Math.max(1, Math.ceil(canvas.height * share));
    const old = this.targets[quality];
    if (old) {
      if (old.width !== width || old.height !== height) old.setSize(width, height);
      return old;
    }
    const made = new WebGLRenderTarget(width, height, {
      colorSpace: LinearSRGBColorSpace,
      samples: quality === 0 ? 4 : 0,
      minFilter: LinearFilter,
      magFilter: LinearFilter,
    });
    this.targets[quality] = made;
    return made;
  }

  /** Draws the target's picture on the canvas. */
  show(renderer: WebGLRenderer, target: WebGLRenderTarget): void {
    const { picture } = this.material.uniforms;
    if (picture) picture.value = target.texture;
    renderer.setRenderTarget(null);
    renderer.render(this.scene, new Camera());
  }

  dispose(): void {
    for (const target of this.targets) target?.dispose();
    this.material.dispose();
  }
}
