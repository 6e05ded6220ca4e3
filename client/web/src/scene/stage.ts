// SPDX-License-Identifier: MIT
// The stage draws a mesh whose colours come from the daemon, the light's reflection, and the
// background. It draws when something changed, and never has more than one frame on the way. Above
// 600 lines: one class decides what is drawn again when the mesh, the light or the camera changes.
import type { Texture } from "three";
import {
  BufferAttribute,
  BufferGeometry,
  Camera,
  DoubleSide,
  FrontSide,
  FloatType,
  GLSL3,
  LinearSRGBColorSpace,
  Matrix3,
  Matrix4,
  Mesh as ThreeMesh,
  PerspectiveCamera,
  RawShaderMaterial,
  Scene,
  Vector3,
  WebGLRenderer,
  WebGLRenderTarget,
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
import { fillHalf, halfTexture } from "./half-texture";
import { isClosed, reachOf } from "./closed";
import { coarseTriangles, standIns } from "./coarse-triangles";
import type { Mesh, Part } from "./geometry";
import { attributesOf } from "./mesh-attributes";
import { lookOf, MapTextures, type Images } from "./surface-maps";
import { ErrorMap, type ErrorPlaces } from "./error-map";
import { FrameQuality, REST_MS, type Quality } from "./frame-quality";
import { Screen } from "./screen";
import { screenTriangle } from "./screen-triangle";
import { Thickness } from "./thickness";
import { orderedTriangles } from "./vertex-order";
import type { StillSurface } from "./still-surface";
import { colorsOf, VertexColors, type VertexTexture } from "./vertex-colors";
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
/** Varyings of the surface, without those of the phases and of texture coordinates. */
const VARYINGS = 9;
/** Meshes of more vertices compute at each vertex, in place of each pixel, which share of a
 * reflection the model does not block. */
const MANY_VERTICES = 5000;
/** Fewer are drawn as they are at any resolution. */
const MANY_TRIANGLES = 20_000;
/** Larger meshes and pictures get no StillSurface, which takes 72 bytes a triangle and 52 a pixel. */
const MOST_STILL_TRIANGLES = 1_000_000;
const MOST_STILL_PIXELS = 2_500_000;
const ONES: Vec3 = [1, 1, 1];
/** Tone curve of the shader: none, linear radiance is kept. */
const LINEAR = 3;

// From the world into a lamp's environment: the columns are the images of the axes.
function turnOf(lamp: Pick<Lamp, "rotateDeg" | "tiltDeg">): number[] {
  const axes: Vec3[] = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ];
  return axes.flatMap((d) => intoEnvironment(d, lamp.rotateDeg, lamp.tiltDeg));
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
  /** Called when the GPU begins a frame. */
  onBegun: (() => void) | null = null;
  private readonly camera = new PerspectiveCamera();
  private readonly scene = new Scene();
  private readonly backdrop = new Scene();
  private readonly sky: RawShaderMaterial;
  private readonly lobes = halfTexture(LEVEL_SIDE + 2, 36);
  private readonly shared: Record<string, IUniform>;
  private geometry: BufferGeometry | null = null;
  private parts: ThreeMesh<BufferGeometry, RawShaderMaterial>[] = [];
  private mesh: Mesh | null = null;
  private coarse: BufferAttribute[] = []; // triangles of each part at half the resolution
  private closed = false; // the mesh has no face that is seen from behind
  private reach = 0; // of the mesh from the centre of its frame
  private within = false; // the eye is nearer than that, perhaps in the mesh: then it may see some
  private textures: MapTextures | null = null;
  private media: readonly Medium[] = [];
  private mediumKey = "";
  private readonly colors = new VertexColors();
  private single = 0; // layers of single scattering
  private exits = 0; // layers of planes of exit, behind them
  private skyCube: Cube | null = null;
  private lobeCube: Cube | null = null; // whose light alone, without its turn, the lobes are of
  private wantsPlain = true;
  private readonly thickness = new Thickness();
  private readonly errorMap = new ErrorMap();
  private places: ErrorPlaces | null = null; // else the bake's errors are
  private thickestMm = 0; // > 0: thickness is drawn in place of light
  private far = 1; // from the eye to its target
  private dirty = false;
  private scheduled = false;
  private fence: WebGLSync | null = null;
  private readonly quality = new FrameQuality();
  private readonly screen = new Screen();
  private last: { quality: Quality; atMs: number } = { quality: 0, atMs: 0 }; // the last frame
  private ticks = 0; // animation frames since the last one was drawn
  private changedMs = 0;
  private makeColors: ((vertices: Uint32Array | null) => VertexTexture) | null = null;
  private made: { vertices: Uint32Array | null; texture: VertexTexture } | null = null;
  private surface = 0; // counts the changes of mesh, maps, media and camera
  private still: StillSurface | null = null; // for frames of less than full quality
  private stillOf = ""; // the surface and the size that it is of
  private stillWanted = ""; // those that it was begun for last
  private lastSeen = ""; // those of the last frame
  private noStill = false; // it failed here
  private unmeasured = 0; // frames whose time says nothing about the GPU, from the one on its way on

  /** Throws where the browser has no WebGL 2. */
  constructor(canvas: HTMLCanvasElement) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({
      canvas,
      antialias: false, // frames in full are drawn into a target of four samples
      powerPreference: "high-performance",
    });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    canvas.addEventListener("webglcontextrestored", () => {
      this.made = null;
      this.dropStill(); // its textures are lost with the context
      this.noStill = false;
    });
    this.shared = {
      exposure: { value: 1 },
      curve: { value: 0 },
      eye: { value: new Vector3() },
      transmission: { value: 1 },
      reflection: { value: 1 },
      split: { value: 0 },
      plainLook: { value: false },
      lobes: { value: this.lobes },
      lobeTurn: { value: new Matrix3() },
      lobeGain: { value: new Vector3(1, 1, 1) },
      vertexColors: { value: null },
    };
    this.sky = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: backgroundVertex,
      defines: { PLAIN: 1 },
      fragmentShader: backgroundFragment,
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
      },
    });
    this.backdrop.add(screenTriangle(this.sky));
  }

  // ---- mesh, colours and light

  /** A mesh without its maps: setMaps adds them. */
  setMesh(mesh: Mesh | null): void {
    this.geometry?.dispose();
    this.removeParts();
    this.geometry = mesh ? attributesOf(mesh) : null;
    this.mesh = mesh;
    this.coarse = [];
    this.closed = mesh !== null && isClosed(mesh.positions, mesh.triangles);
    this.reach = mesh ? reachOf(mesh.positions, mesh.frame.centre) : 0;
    this.makeColors = this.made = null;
    this.media = [];
    this.places = null;
    if (mesh) this.setMaps(new Map());
    this.redraw();
  }

  private removeParts(): void {
    for (const part of this.parts) {
      part.material.dispose();
      part.geometry.dispose(); // `geometry` itself is never drawn: its dispose() frees nothing
      this.scene.remove(part);
    }
    this.parts = [];
    this.textures?.dispose();
    this.textures = null;
    this.dropStill();
  }

  private dropStill(): void {
    this.still?.dispose();
    this.still = null;
    this.stillOf = this.stillWanted = "";
    this.surface++;
  }

  /** The images of the mesh's maps, those that are here. */
  setMaps(images: Images): void {
    const { mesh, geometry: all } = this;
    if (!mesh || !all) return;
    this.removeParts();
    const anisotropy = this.renderer.capabilities.getMaxAnisotropy();
    const textures = (this.textures = new MapTextures(images, anisotropy));
    this.value("split", mesh.split);
    for (const part of mesh.parts) {
      // Parts share the attributes; each draws its run of the index.
      const geometry = new BufferGeometry();
      for (const [name, attribute] of Object.entries(all.attributes))
        geometry.setAttribute(name, attribute);
      geometry.setIndex(all.index);
      geometry.setDrawRange(part.firstIndex, part.nIndex);
      const drawn = new ThreeMesh(geometry, this.materialOf(mesh, part, textures));
      drawn.frustumCulled = false;
      this.parts.push(drawn);
      this.scene.add(drawn);
    }
    const translucent = this.parts.filter((_, i) => !mesh.parts[i]?.opaque);
    this.thickness.setParts(translucent.map(({ geometry }) => geometry));
    this.errorMap.setParts(translucent.map(({ geometry }) => geometry));
    if (this.places) this.errorMap.setErrors(this.places, mesh.positions);
    this.applyMedia();
  }

  private get side() {
    return this.closed && !this.within ? FrontSide : DoubleSide;
  }

  private materialOf(mesh: Mesh, part: Part, textures: MapTextures): RawShaderMaterial {
    const look = lookOf(part.surface, textures, {
      nUv: mesh.uv.length,
      tinted: mesh.tint !== null,
      opaque: part.opaque,
    });
    const defines: Record<string, number> = {
      ...look.defines,
      N_UV: look.uvSets.length,
      VERTEX_WIDTH,
      ...(mesh.cornerUv ? { SEAMS: 1 } : {}),
      ...(mesh.blocked ? { BLOCKED: mesh.nVertex > MANY_VERTICES ? 2 : 1 } : {}),
    };
    return new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: surfaceVertex(look.uvSets),
      fragmentShader: surfaceFragment,
      defines: { ...defines, ...this.layerDefines(look.uvSets.length) },
      side: this.side,
      uniforms: {
        ...this.shared,
        ...look.uniforms,
        eta: { value: 1.3 },
        roughness: { value: 0.3 },
        divisor: { value: 1 },
        viewSlope: { value: 0 },
        opaque: { value: part.opaque ? 1 : 0 },
      },
    });
  }

  private value(name: string, value: unknown): void {
    const uniform = this.shared[name];
    if (uniform) uniform.value = value;
  }

  // Phases behind S_0 take a varying each; those beyond the browser's limit are shaded at the
  // vertices.
  private layerDefines(nUv: number): Record<string, number> {
    const free = this.renderer.capabilities.maxVaryings - VARYINGS - nUv;
    return {
      N_SINGLE: this.single,
      N_EXIT: this.exits,
      N_PIXEL: Math.max(0, Math.min(this.single - 1, free)),
    };
  }

  /** Colours as the daemon sends them, in RGB9E5 or halves, or made of those of fewer vertices. */
  takeColors(answer: ColorsAnswer, payload: Uint8Array, made?: Float32Array): void {
    const colors = colorsOf(answer, payload, made);
    this.light((vertices) => this.colors.put(colors, vertices));
  }

  /** What makes the colours: of all vertices (null), or of some, in the order of their list. It runs
   * before the next frame, with the renderer free, and replaces one that waits: where nothing is drawn (a
   * tab behind others) none pile up. It runs again when colours of other vertices are wanted. */
  light(colors: (vertices: Uint32Array | null) => VertexTexture): void {
    if (!this.mesh) return;
    this.makeColors = colors;
    this.made = null;
    this.redraw();
  }

  // The newest colours, of these vertices.
  private colorsFor(vertices: Uint32Array | null): VertexTexture | null {
    if (!this.makeColors) return null;
    if (this.made?.vertices !== vertices)
      this.made = { vertices, texture: this.makeColors(vertices) };
    return this.made?.texture ?? null;
  }

  // The surface is drawn with the colours of all vertices.
  private useColors({ texture, layers, exits }: VertexTexture): void {
    this.value("vertexColors", texture);
    if (layers - 1 - exits !== this.single || exits !== this.exits) {
      this.single = layers - 1 - exits;
      this.exits = exits;
      for (const part of this.parts) {
        const { defines } = part.material as { defines: Record<string, number> };
        Object.assign(defines, this.layerDefines(defines.N_UV ?? 0));
        part.material.needsUpdate = true;
      }
    }
  }

  /** media: of each block of GEOMETRY, or one for all. */
  setMedium(
    media: readonly Medium[],
    apply: { transmission: boolean; reflection: boolean; look: boolean },
  ): void {
    const key = JSON.stringify([media, apply]);
    if (key !== this.mediumKey) this.surface++;
    this.mediumKey = key;
    this.media = media;
    this.applyMedia();
    this.value("transmission", apply.transmission ? 1 : 0);
    this.value("reflection", apply.reflection ? 1 : 0);
    this.value("plainLook", !apply.look);
    this.redraw();
  }

  private applyMedia(): void {
    const { media } = this;
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
    this.redraw();
  }

  /** Thickness in place of light, brightest at this many mm; 0: light. */
  showThickness(mostMm: number): void {
    this.thickestMm = mostMm;
    this.redraw();
  }

  /** Errors in place of light, brightest at `most`, 0: ratios less 1; null: light. */
  showErrors(places: ErrorPlaces | null, most: number): void {
    this.errorMap.setMost(most);
    if (places && places !== this.places && this.mesh)
      this.errorMap.setErrors(places, this.mesh.positions);
    this.places = this.mesh && places;
    this.redraw();
  }

  setLook(look: Look): void {
    this.value("exposure", 2 ** look.exposure);
    this.value("curve", look.tone);
    const u = this.sky.uniforms;
    this.wantsPlain = look.plain !== null;
    this.useSky();
    if (u.plain && look.plain) (u.plain.value as Vector3).set(...look.plain);
    this.redraw();
  }

  /** The lamps: reflections see their sum, the background shows the first. The light of one lamp is
   * filtered once, and turned in the shader. */
  setLamps(lamps: readonly Lamp[]): void {
    const [first, second] = lamps;
    const alone = first && !second ? first : null;
    if (!alone || alone.cube !== this.lobeCube) {
      const still = alone && { ...alone, rotateDeg: 0, tiltDeg: 0, gain: ONES };
      fillHalf(this.lobes, filterStack(summed(still ? [still] : lamps, LEVEL_SIDE)));
      this.lobeCube = alone?.cube ?? null;
    }
    (this.shared.lobeTurn?.value as Matrix3).fromArray(
      turnOf(alone ?? { rotateDeg: 0, tiltDeg: 0 }),
    );
    (this.shared.lobeGain?.value as Vector3).set(...(alone?.gain ?? ONES));
    if (first) this.setSky(first);
    this.redraw();
  }

  private useSky(): void {
    const plain = this.wantsPlain || !this.skyCube;
    if (plain === "PLAIN" in (this.sky.defines ?? {})) return;
    this.sky.defines = plain ? { PLAIN: 1 } : {};
    this.sky.needsUpdate = true;
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
      this.useSky();
    }
    if (u.turn) (u.turn.value as Matrix3).fromArray(turnOf(lamp));
    if (u.gain) (u.gain.value as Vector3).set(...lamp.gain);
  }

  setCamera(placed: Placed, radius: number): void {
    const { camera } = this;
    const before = [...camera.matrixWorld.elements, ...camera.projectionMatrix.elements];
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
    const now = [...camera.matrixWorld.elements, ...camera.projectionMatrix.elements];
    if (now.some((x, i) => x !== before[i])) this.surface++;
    const { centre } = this.mesh?.frame ?? {};
    const within = !!centre && eye.distanceTo(new Vector3(...centre)) < this.reach;
    if (within !== this.within) {
      this.within = within;
      for (const { material } of this.parts) material.side = this.side;
      this.still?.setSide(this.side);
      this.surface++;
    }
    this.value("eye", eye);
    this.far = distance;
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

  redraw(): void {
    this.dirty = true;
    this.changedMs = performance.now();
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
    const nowMs = performance.now();
    if (this.unmeasured) this.unmeasured--;
    else this.quality.drawn(this.last.quality, nowMs - this.last.atMs, this.ticks <= 1, nowMs);
    this.finished++;
    this.onDrawn?.();
    return true;
  }

  /** Whether a change waits until the GPU has finished the frame before. */
  get waits(): boolean {
    return this.dirty;
  }
  /** Of LEVELS (pace.ts), the least that frames of a moving hand are to have. */
  get leastLevel(): number {
    return this.quality.leastLevel;
  }
  /** Whether the picture is there in full: nothing changed, and the GPU has finished it. */
  get rests(): boolean {
    return this.idle && !this.dirty && this.last.quality === 0;
  }

  // What moves is drawn as finely as the GPU follows, and what has come to rest in full.
  private tick(): void {
    this.scheduled = false;
    this.ticks++;
    if (this.idle) {
      const nowMs = performance.now();
      const rested = nowMs - this.changedMs > REST_MS;
      if (this.dirty) this.draw(this.quality.moving, nowMs);
      else if (rested && this.last.quality > 0) this.draw(0, nowMs);
      else if (rested) this.awaitHand();
    }
    if (!this.dirty && !this.fence && this.last.quality === 0) return;
    this.scheduled = true;
    requestAnimationFrame(() => this.tick());
  }

  // The picture rests: what its eye sees is found before the light moves again.
  private awaitHand(): void {
    if (!this.quality.moving) return;
    const { width, height } =
      this.screen.target(this.quality.moving, this.canvas) ?? this.canvas;
    void this.makeStill(`${this.surface} ${width} ${height}`, width, height);
  }

  private draw(quality: Quality, nowMs: number): void {
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    this.dirty = false;
    this.last = { quality, atMs: nowMs };
    this.ticks = 0;
    const target = this.screen.target(quality, this.canvas);
    const still = quality > 0 ? this.stillFor(target ?? this.canvas) : null;
    if (still) this.drawStill(target, still);
    else {
      this.useTriangles(quality);
      this.drawInto(target);
      this.useTriangles(0);
    }
    if (target) this.screen.show(this.renderer, target);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.onBegun?.();
  }

  // Of half the resolution the surface has fewer triangles, made when they are wanted first.
  private useTriangles(quality: Quality): void {
    const { mesh } = this;
    if (!mesh || mesh.cornerUv || mesh.triangles.length < 3 * MANY_TRIANGLES) return;
    if (quality === 2 && !this.coarse.length) {
      const stands = standIns(mesh.positions, mesh.normals);
      this.coarse = mesh.parts.map(({ firstIndex, nIndex }) => {
        const own = coarseTriangles(mesh.triangles, firstIndex / 3, nIndex / 3, stands);
        return new BufferAttribute(orderedTriangles(own, 0, own.length / 3, mesh.nVertex), 1);
      });
    }
    this.parts.forEach(({ geometry }, i) => {
      const part = mesh.parts[i];
      const coarse = quality === 2 ? this.coarse[i] : undefined;
      if (!part || geometry.index === (coarse ?? this.geometry?.index)) return;
      geometry.setIndex(coarse ?? this.geometry?.index ?? null);
      if (coarse) geometry.setDrawRange(0, coarse.count);
      else geometry.setDrawRange(part.firstIndex, part.nIndex);
    });
  }

  private drawInto(target: WebGLRenderTarget | null, model = true): void {
    const { renderer } = this;
    const colors = this.colorsFor(null);
    if (colors) this.useColors(colors);
    renderer.setRenderTarget(target);
    renderer.clear();
    const lit = model && colors && this.mesh && !this.thickestMm && !this.places;
    if (lit) renderer.render(this.scene, this.camera);
    this.drawBackdrop();
    if (model && this.mesh && this.thickestMm) this.drawThickness(target, this.mesh);
    else if (model && this.places && this.mesh) this.errorMap.draw(renderer, this.camera);
    renderer.setRenderTarget(null);
  }

  // Fills the pixels that the model does not cover.
  private drawBackdrop(): void {
    this.renderer.render(this.backdrop, new Camera());
  }

  // ---- a surface that rests under a light that moves

  private drawStill(target: WebGLRenderTarget | null, still: StillSurface): void {
    const { renderer } = this;
    const colors = this.colorsFor(still.visible);
    renderer.setRenderTarget(target);
    renderer.clear();
    if (colors) still.draw(renderer, colors);
    this.drawBackdrop();
    renderer.setRenderTarget(null);
  }

  // The StillSurface of this mesh and camera; null: there is none yet. It is made when two frames in a
  // row have the same mesh and camera.
  private stillFor(size: { width: number; height: number }): StillSurface | null {
    if (this.thickestMm || this.places) return null;
    const { width, height } = size;
    const seen = `${this.surface} ${width} ${height}`;
    const rests = seen === this.lastSeen;
    this.lastSeen = seen;
    if (this.still?.visible && this.stillOf === seen) return this.still;
    if (rests) void this.makeStill(seen, width, height);
    return null;
  }

  // Where it can't be loaded or read back, it is not tried again: frames are drawn as before.
  private async makeStill(seen: string, width: number, height: number): Promise<void> {
    const { mesh } = this;
    if (!mesh || !this.makeColors || this.thickestMm || this.places) return;
    if (this.noStill || seen === this.stillWanted) return;
    if (mesh.triangles.length > 3 * MOST_STILL_TRIANGLES) return;
    if (width * height > MOST_STILL_PIXELS) return;
    this.stillWanted = seen;
    try {
      const { StillSurface } = await import("./still-surface");
      if (mesh !== this.mesh || this.stillWanted !== seen) return;
      const still = (this.still ??= new StillSurface(mesh, this.parts, this.shared));
      this.stillOf = seen;
      this.unmeasured = 2; // they wait for this, too
      await still.begin(this.renderer, this.camera, width, height);
    } catch {
      this.noStill = true;
      this.dropStill();
    }
  }

  private drawThickness(target: WebGLRenderTarget | null, mesh: Mesh): void {
    const { renderer, camera, far } = this;
    const { width, height } = target ?? this.canvas;
    const view = { camera, eye: camera.position, far, mmPerUnit: mesh.mmPerUnit };
    this.thickness.draw(renderer, target, { width, height }, view, this.thickestMm);
  }

  /** Thickness in mm along each line of sight, bottom row first; NaN beside the model. */
  readThickness(width: number, height: number): Float32Array {
    const { mesh } = this;
    if (!mesh) return new Float32Array(0);
    const target = new WebGLRenderTarget(width, height);
    this.drawThickness(target, mesh);
    this.renderer.setRenderTarget(null);
    target.dispose();
    return this.thickness.read(this.renderer);
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
    this.drawInto(target, model);
    const out = new Uint8Array(width * height * 4);
    this.renderer.readRenderTargetPixels(target, 0, 0, width, height, out);
    target.dispose();
    return out;
  }

  dispose(): void {
    this.setMesh(null);
    this.thickness.dispose();
    this.errorMap.dispose();
    this.sky.dispose();
    this.lobes.dispose();
    this.colors.dispose();
    this.screen.dispose();
    this.still?.dispose();
    this.renderer.dispose();
  }
}
