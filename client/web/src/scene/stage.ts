// SPDX-License-Identifier: MIT
// The stage draws a mesh whose colours come from the daemon, the light's reflection, and the
// background. It draws when something changed, and never has more than one frame on the way.
import type { Texture } from "three";
import {
  BufferAttribute,
  BufferGeometry,
  Camera,
  DataArrayTexture,
  DataTexture,
  DoubleSide,
  FloatType,
  GLSL3,
  HalfFloatType,
  InterleavedBuffer,
  InterleavedBufferAttribute,
  LinearFilter,
  LinearSRGBColorSpace,
  Matrix3,
  Matrix4,
  Mesh as ThreeMesh,
  PerspectiveCamera,
  RawShaderMaterial,
  RGBAFormat,
  Scene,
  UnsignedByteType,
  Vector3,
  Vector4,
  WebGLRenderer,
  WebGLRenderTarget,
  DataUtils,
  type IUniform,
} from "three";
import type { ColorsAnswer } from "../gen/relight_pb";
import type { Placed, Vec3 } from "./camera";
import {
  bordered,
  filterStack,
  intoEnvironment,
  LEVEL_SIDE,
  summed,
  type Cube,
  type Lamp,
} from "./environment";
import type { Mesh } from "./geometry";
import { VertexColors, type VertexTexture } from "./vertex-colors";
import {
  backgroundFragment,
  backgroundVertex,
  surfaceFragment,
  surfaceVertex,
  VERTEX_WIDTH,
} from "./shaders";

/** How the surface turns its colours into radiance towards the eye. */
export interface Medium {
  eta: number;
  roughness: number;
  /** The factor that the colours already have: T̄, or the divisor of coefficients. */
  divisor: number;
  viewSlope: number;
}
export interface Look {
  /** EV. */
  exposure: number;
  /** 0 filmic, 1 Reinhard, 2 none. */
  tone: number;
  /** Linear RGB behind the model in place of the environment; null: the environment. */
  plain: Vec3 | null;
}
/** Varyings of the surface, without those of the phases. */
const VARYINGS = 10;
/** Tone curve of the shader: none, linear radiance is kept. */
const LINEAR = 3;

function halfTexture(side: number, layers: number): DataArrayTexture {
  const texture = new DataArrayTexture(
    new Uint16Array(side * side * layers * 4),
    side,
    side,
    layers,
  );
  texture.format = RGBAFormat;
  texture.type = HalfFloatType;
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.colorSpace = LinearSRGBColorSpace;
  return texture;
}
function fillHalf(texture: DataArrayTexture, values: Float32Array): void {
  const data = texture.image.data as Uint16Array;
  for (let i = 0; i < data.length; i++)
    data[i] = DataUtils.toHalfFloat(Math.min(values[i] ?? 0, 65504));
  texture.needsUpdate = true;
}

/** RGBA pictures of `width` pixels a row: the mean of each fine x fine block. */
export function meanOfBlocks(points: Float32Array, width: number, fine: number): Float32Array {
  const out = new Float32Array(points.length / (fine * fine));
  for (let i = 0; i < points.length; i++) {
    const x = Math.floor(i / 4) % width;
    const y = Math.floor(i / 4 / width);
    const to = 4 * ((Math.floor(y / fine) * width) / fine + Math.floor(x / fine)) + (i % 4);
    out[to] = (out[to] ?? 0) + (points[i] ?? 0) / (fine * fine);
  }
  return out;
}

export class Stage {
  readonly canvas: HTMLCanvasElement;
  readonly renderer: WebGLRenderer;
  /** Frames that the GPU finished. */
  finished = 0;
  /** Called after each frame that was drawn. */
  onDrawn: (() => void) | null = null;
  private readonly camera = new PerspectiveCamera();
  private readonly scene = new Scene();
  private readonly backdrop = new Scene();
  private readonly sky: RawShaderMaterial;
  private readonly lobes = halfTexture(LEVEL_SIDE + 2, 36);
  private readonly shared: Record<string, IUniform>;
  private geometry: BufferGeometry | null = null;
  private parts: ThreeMesh<BufferGeometry, RawShaderMaterial>[] = [];
  private mesh: Mesh | null = null;
  private readonly colors = new VertexColors();
  private single = 0; // layers of single scattering
  private hasColors = false;
  private skyCube: Cube | null = null;
  private wantsPlain = true;
  private dirty = false;
  private scheduled = false;
  private fence: WebGLSync | null = null;
  private readonly before: (() => void)[] = [];

  /** Throws where the browser has no WebGL 2. */
  constructor(canvas: HTMLCanvasElement) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({
      canvas,
      antialias: true,
      powerPreference: "high-performance",
    });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    this.shared = {
      exposure: { value: 1 },
      curve: { value: 0 },
      eye: { value: new Vector3() },
      transmission: { value: 1 },
      reflection: { value: 1 },
      split: { value: 0 },
      lobes: { value: this.lobes },
      vertexColors: { value: null },
    };
    this.sky = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: backgroundVertex,
      fragmentShader: backgroundFragment,
      depthTest: false,
      depthWrite: false,
      uniforms: {
        exposure: this.shared.exposure as IUniform,
        curve: this.shared.curve as IUniform,
        unproject: { value: new Matrix4() },
        sky: { value: halfTexture(3, 6) },
        side: { value: 1 },
        turn: { value: new Matrix3() },
        gain: { value: new Vector3(1, 1, 1) },
        plain: { value: new Vector3(0.018, 0.019, 0.022) },
        isPlain: { value: true },
      },
    });
    const triangle = new BufferGeometry();
    triangle.setAttribute(
      "position",
      new BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3),
    );
    const backdrop = new ThreeMesh(triangle, this.sky);
    backdrop.frustumCulled = false;
    this.backdrop.add(backdrop);
  }

  // ---- mesh, colours and light

  setMesh(mesh: Mesh | null, images: (hash: number) => Texture | null = () => null): void {
    this.geometry?.dispose();
    for (const part of this.parts) {
      part.material.dispose();
      this.scene.remove(part);
    }
    this.parts = [];
    this.geometry = null;
    this.mesh = mesh;
    this.hasColors = false;
    if (mesh) this.build(mesh, images);
    this.redraw();
  }

  private build(mesh: Mesh, images: (image: number) => Texture | null): void {
    const all = (this.geometry = new BufferGeometry());
    all.setAttribute("position", new BufferAttribute(mesh.positions, 3));
    all.setAttribute("normal", new BufferAttribute(mesh.normals, 3));
    if (mesh.uv) all.setAttribute("uv", new BufferAttribute(mesh.uv, 2));
    if (mesh.tint) all.setAttribute("tint", new BufferAttribute(mesh.tint, 4));
    if (mesh.blocked) {
      const sky = new InterleavedBuffer(mesh.blocked, 16);
      for (let i = 0; i < 4; i++)
        all.setAttribute(`blocked${i}`, new InterleavedBufferAttribute(sky, 4, 4 * i));
    }
    all.setIndex(new BufferAttribute(mesh.triangles, 1));
    this.value("split", mesh.split);
    for (const part of mesh.parts) {
      // Parts share the attributes; each draws its run of the index.
      const geometry = new BufferGeometry();
      for (const [name, attribute] of Object.entries(all.attributes))
        geometry.setAttribute(name, attribute);
      geometry.setIndex(all.index);
      geometry.setDrawRange(part.firstIndex, part.nIndex);
      const surface = part.surface;
      const map = surface?.baseMap ? images(surface.baseMap.image) : null;
      const factor = surface?.baseColor.length === 4 ? surface.baseColor : [1, 1, 1, 1];
      // Without a map or vertex colours the medium alone gives a translucent surface its colour;
      // colours of opaque ones have their base colour in them.
      const material = new RawShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: surfaceVertex,
        fragmentShader: surfaceFragment,
        defines: {
          ...this.layerDefines(),
          VERTEX_WIDTH,
          ...(mesh.blocked ? { BLOCKED: 1 } : {}),
        },
        side: DoubleSide,
        uniforms: {
          ...this.shared,
          eta: { value: 1.3 },
          roughness: { value: 0.3 },
          divisor: { value: 1 },
          viewSlope: { value: 0 },
          opaque: { value: part.opaque ? 1 : 0 },
          baseMap: { value: map },
          baseColor: { value: new Vector4(...(factor as [number, number, number, number])) },
          hasBase: { value: map !== null || mesh.tint !== null },
          hasMap: { value: map !== null },
        },
      });
      const drawn = new ThreeMesh(geometry, material);
      drawn.frustumCulled = false;
      this.parts.push(drawn);
      this.scene.add(drawn);
    }
  }

  private value(name: string, value: unknown): void {
    const uniform = this.shared[name];
    if (uniform) uniform.value = value;
  }

  // Phases behind S_0 take a varying each; those beyond the browser's limit are shaded at the
  // vertices.
  private layerDefines(): Record<string, number> {
    const free = this.renderer.capabilities.maxVaryings - VARYINGS;
    return {
      N_SINGLE: this.single,
      N_PIXEL: Math.max(0, Math.min(this.single - 1, free)),
    };
  }

  /** Colours as the daemon sends them, in RGB9E5 or halves. */
  takeColors(answer: ColorsAnswer, payload: Uint8Array): void {
    this.setColors(this.colors.take(answer, payload));
  }

  /** Colours of all vertices, as long as the texture lives. */
  setColors({ texture, layers }: VertexTexture): void {
    if (!this.mesh) return;
    this.value("vertexColors", texture);
    this.hasColors = true;
    if (layers - 1 !== this.single) {
      this.single = layers - 1;
      for (const part of this.parts) {
        Object.assign(part.material.defines, this.layerDefines());
        part.material.needsUpdate = true;
      }
    }
    this.redraw();
  }

  /** media: of each block of GEOMETRY, or one for all. */
  setMedium(
    media: readonly Medium[],
    apply: { transmission: boolean; reflection: boolean },
  ): void {
    this.parts.forEach((part, i) => {
      const block = this.mesh?.parts[i]?.block ?? 0;
      const medium = media[media.length > 1 ? block : 0];
      const u = part.material.uniforms;
      if (!medium) return;
      if (u.eta) u.eta.value = medium.eta;
      if (u.roughness) u.roughness.value = medium.roughness;
      if (u.divisor) u.divisor.value = medium.divisor;
      if (u.viewSlope) u.viewSlope.value = medium.viewSlope;
    });
    this.value("transmission", apply.transmission ? 1 : 0);
    this.value("reflection", apply.reflection ? 1 : 0);
    this.redraw();
  }

  setLook(look: Look): void {
    this.value("exposure", 2 ** look.exposure);
    this.value("curve", look.tone);
    const u = this.sky.uniforms;
    this.wantsPlain = look.plain !== null;
    if (u.isPlain) u.isPlain.value = this.wantsPlain || !this.skyCube;
    if (u.plain && look.plain) (u.plain.value as Vector3).set(...look.plain);
    this.redraw();
  }

  /** The lamps: reflections see their sum, the background shows the first. */
  setLamps(lamps: readonly Lamp[]): void {
    const first = lamps[0];
    const light = first
      ? summed(lamps, LEVEL_SIDE)
      : { n: LEVEL_SIDE, texel: new Float32Array(18 * LEVEL_SIDE ** 2) };
    fillHalf(this.lobes, filterStack(light));
    if (first) this.setSky(first);
    this.redraw();
  }

  private setSky(lamp: Lamp): void {
    const u = this.sky.uniforms;
    if (lamp.cube !== this.skyCube && u.sky && u.side) {
      (u.sky.value as Texture).dispose();
      const texture = halfTexture(lamp.cube.n + 2, 6);
      fillHalf(texture, bordered(lamp.cube));
      u.sky.value = texture;
      u.side.value = lamp.cube.n;
      this.skyCube = lamp.cube;
      if (u.isPlain) u.isPlain.value = this.wantsPlain;
    }
    const axes = (
      [
        [1, 0, 0],
        [0, 1, 0],
        [0, 0, 1],
      ] as Vec3[]
    ).map((d) => intoEnvironment(d, lamp.rotateDeg, lamp.tiltDeg));
    // Columns of the matrix are the images of the axes.
    if (u.turn) (u.turn.value as Matrix3).fromArray(axes.flat());
    if (u.gain) (u.gain.value as Vector3).set(...lamp.gain);
  }

  setCamera(placed: Placed, radius: number): void {
    const { camera } = this;
    const eye = new Vector3(...placed.eye);
    const target = new Vector3(...placed.target);
    const distance = eye.distanceTo(target);
    camera.fov = placed.fovyDeg;
    camera.near = Math.max(distance - 3 * radius, distance / 100);
    camera.far = distance + 3 * radius;
    camera.aspect = this.canvas.width / Math.max(1, this.canvas.height);
    camera.position.copy(eye);
    camera.up.set(...placed.up);
    camera.updateMatrixWorld(true); // lookAt reads the position from it
    camera.lookAt(target);
    camera.updateMatrixWorld(true);
    camera.updateProjectionMatrix();
    this.value("eye", eye);
    const turnOnly = camera.matrixWorld.clone().setPosition(0, 0, 0);
    const u = this.sky.uniforms;
    if (u.unproject)
      (u.unproject.value as Matrix4).multiplyMatrices(turnOnly, camera.projectionMatrixInverse);
    this.redraw();
  }

  /** Size in pixels of the screen. */
  resize(width: number, height: number): void {
    this.renderer.setSize(width, height, false);
    this.redraw();
  }

  // ---- when it is drawn

  /** Runs before the next frame, with the renderer free: the pass that multiplies coefficients. */
  beforeNext(pass: () => void): void {
    this.before.push(pass);
    this.redraw();
  }

  redraw(): void {
    this.dirty = true;
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame(() => this.tick());
  }

  /** Whether the GPU has finished the last frame. */
  get idle(): boolean {
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    if (!this.fence) return true;
    const status = gl.clientWaitSync(this.fence, 0, 0);
    if (status === gl.TIMEOUT_EXPIRED) return false;
    gl.deleteSync(this.fence);
    this.fence = null;
    this.finished++;
    this.onDrawn?.();
    return true;
  }

  private tick(): void {
    this.scheduled = false;
    if (this.idle && this.dirty) {
      this.draw();
      const gl = this.renderer.getContext() as WebGL2RenderingContext;
      this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
      gl.flush();
    }
    if (!this.dirty && !this.fence) return;
    this.scheduled = true;
    requestAnimationFrame(() => this.tick());
  }

  private draw(): void {
    this.dirty = false;
    for (const pass of this.before.splice(0)) pass();
    this.drawInto(null);
  }

  private drawInto(target: WebGLRenderTarget | null, model = true): void {
    const { renderer } = this;
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(this.backdrop, new Camera());
    if (model && this.hasColors && this.mesh) renderer.render(this.scene, this.camera);
    renderer.setRenderTarget(null);
  }

  /** Linear radiance of the picture as it is now, float RGBA, bottom row first, each pixel the mean
   * of fine x fine points; for tests and for differences. */
  readLinear(width: number, height: number, fine = 3): Float32Array {
    const [w, h] = [width * fine, height * fine];
    const target = new WebGLRenderTarget(w, h, {
      type: FloatType,
      colorSpace: LinearSRGBColorSpace,
    });
    const curve: unknown = this.shared.curve?.value;
    for (const pass of this.before.splice(0)) pass();
    this.value("curve", LINEAR);
    this.drawInto(target);
    this.value("curve", curve);
    const points = new Float32Array(w * h * 4);
    this.renderer.readRenderTargetPixels(target, 0, 0, w, h, points);
    target.dispose();
    return meanOfBlocks(points, w, fine);
  }

  /** The picture as it is shown, RGBA of 8 bits, bottom row first; without the model: the background
   * alone. */
  readEncoded(width: number, height: number, model = true): Uint8Array {
    const target = new WebGLRenderTarget(width, height, {
      colorSpace: LinearSRGBColorSpace,
      samples: 4,
    });
    for (const pass of this.before.splice(0)) pass();
    this.drawInto(target, model);
    const out = new Uint8Array(width * height * 4);
    this.renderer.readRenderTargetPixels(target, 0, 0, width, height, out);
    target.dispose();
    return out;
  }

  /** A texture of GEOMETRY's image: RGBA of 8 bits, level 0; mip levels are made here. */
  static image(texels: Uint8Array, width: number, height: number): Texture {
    const texture = new DataTexture(
      texels.slice(0, 4 * width * height),
      width,
      height,
      RGBAFormat,
      UnsignedByteType,
    );
    texture.generateMipmaps = true;
    return texture;
  }

  dispose(): void {
    this.setMesh(null);
    this.sky.dispose();
    this.lobes.dispose();
    this.colors.dispose();
    this.renderer.dispose();
  }
}
