// SPDX-License-Identifier: MIT
// Deferred shading while only the light changes. The surface is drawn once into textures that hold, for each
// pixel, the three vertices of its triangle and all that does not depend on the light. A frame then
// runs no vertex shader over the mesh, and needs the colours of the visible vertices alone.
import {
  AlwaysDepth,
  BufferAttribute,
  BufferGeometry,
  Camera,
  DataTexture,
  FrontSide,
  GLSL3,
  HalfFloatType,
  IntType,
  LinearSRGBColorSpace,
  Mesh as ThreeMesh,
  NearestFilter,
  RawShaderMaterial,
  RGBAFormat,
  RGBAIntegerFormat,
  Scene,
  UnsignedIntType,
  WebGLRenderTarget,
  type IUniform,
  type Side,
  type WebGLRenderer,
} from "three";
import type { Mesh } from "./geometry";
import { screenTriangle } from "./screen-triangle";
import { cube, harmonics, reflection, tone, VERTEX_WIDTH } from "./shaders";
import type { VertexTexture } from "./vertex-colors";

const cornersVertex = /* glsl */ `
precision highp float;
precision highp int;
uniform mat4 modelViewMatrix, projectionMatrix;
in vec3 position;
in uvec3 triangle; // its vertices, at each of the three corners
flat out uvec3 corners;
out vec2 weights;
invariant gl_Position; // as in the pass of the surface: of two triangles at one depth both take the same
void main() {
  int corner = gl_VertexID % 3;
  corners = triangle;
  weights = vec2(corner == 0, corner == 1);
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const cornersFragment = /* glsl */ `
precision highp float;
precision highp int;
flat in uvec3 corners;
in vec2 weights;
out uvec4 seen;
void main() { seen = uvec4(corners, packUnorm2x16(weights)); }`;

const screenVertex = /* glsl */ `
precision highp float;
in vec3 position;
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`;
const litFragment = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2DArray;
uniform highp usampler2D corners;
uniform highp sampler2D still0, still1, still2, still3;
uniform highp sampler2DArray vertexColors;
out vec4 color;
${tone}
${cube}
${harmonics}
${reflection}
uvec3 v;
vec3 weights;
vec3 of(uint vertex, int layer) {
  int i = int(vertex);
  return texelFetch(vertexColors, ivec3(i % VERTEX_WIDTH, i / VERTEX_WIDTH, layer), 0).rgb;
}
vec3 part(int layer) {
  return weights.x * of(v.x, layer) + weights.y * of(v.y, layer) + weights.z * of(v.z, layer);
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  uvec4 seen = texelFetch(corners, at, 0);
  if (seen.x == seen.y) discard; // beside the model
  v = seen.xyz;
  weights.xy = unpackUnorm2x16(seen.w);
  weights.z = 1.0 - weights.x - weights.y;
  vec4 through = texelFetch(still0, at, 0), mirror = texelFetch(still1, at, 0);
  vec4 rest = texelFetch(still2, at, 0);
  vec3 multiple = part(0), single = vec3(0.0);
#if N_SINGLE > 0
  single = part(1);
#endif
#if N_SINGLE > 1 || N_EXIT > 0
  float y[16];
  harmonics(texelFetch(still3, at, 0).xyz, y);
  for (int k = 1; k < N_SINGLE; k++) single += y[k] * part(1 + k);
  for (int k = 0; k < N_EXIT; k++) multiple += (k > 0 ? y[k] : 1.0) * part(1 + N_SINGLE + k);
#endif
  vec3 body = max(through.rgb * (multiple + through.a * single), vec3(0.0)) + rest.rgb;
  if (mirror.a > 0.0) body += mirror.a * reflected(mirror.xyz, rest.a);
  color = vec4(encoded(body), 1.0);
}`;

/** A part of the model with the material that draws it. */
type Part = ThreeMesh<BufferGeometry, RawShaderMaterial>;

/** Triangles that share no vertex, in the order of the index: the position of each corner, and the three
 * vertices of its triangle. source: the vertex of the file that a vertex at a seam is a copy of. */
export function apart(
  index: ArrayLike<number>,
  positions: ArrayLike<number>,
  source: ArrayLike<number> | null,
): { at: Float32Array; triangle: Uint32Array } {
  const at = new Float32Array(3 * index.length);
  const triangle = new Uint32Array(3 * index.length);
  for (let i = 0; i < index.length; i++) {
    const v = index[i] ?? 0;
    const first = i - (i % 3);
    for (let k = 0; k < 3; k++) {
      const other = index[first + k] ?? 0;
      at[3 * i + k] = positions[3 * v + k] ?? 0;
      triangle[3 * i + k] = source?.[other] ?? other;
    }
  }
  return { at, triangle };
}

// Whether both targets were drawn into once. Their status is asked for until then: the answer waits for
// the GPU.
let complete = false;
// It is the same for all materials of a mesh.
const corners = new WeakMap<Mesh, ReturnType<typeof apart>>();
function cornersGeometry(mesh: Mesh, { index, attributes }: BufferGeometry): BufferGeometry {
  const { position, source } = attributes;
  let own = corners.get(mesh);
  if (!own && index && position) {
    own = apart(index.array, position.array, source?.array ?? null);
    corners.set(mesh, own);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(own?.at ?? new Float32Array(0), 3));
  const triangle = new BufferAttribute(own?.triangle ?? new Uint32Array(0), 3);
  triangle.gpuType = IntType;
  geometry.setAttribute("triangle", triangle);
  return geometry;
}

/** The vertices of the corners that are seen (four words a pixel, three of them vertices), each
 * once; the corners are then places among these. */
export function seenVertices(corners: Uint32Array, nVertex: number): Uint32Array {
  const place = new Uint32Array(nVertex); // 1 + place
  const seen: number[] = [];
  for (let i = 0; i < corners.length; i += 4) {
    if (corners[i] === corners[i + 1]) continue;
    for (let k = i; k < i + 3; k++) {
      const v = corners[k] ?? 0;
      corners[k] = (place[v] ||= seen.push(v)) - 1;
    }
  }
  return Uint32Array.from(seen);
}

export class StillSurface {
  /** The vertices that are seen, those whose colours draw() takes; null until begin() has ended. */
  visible: Uint32Array | null = null;
  private readonly nVertex: number;
  private readonly scene = new Scene();
  private readonly outline = new Scene(); // triangles with their corners
  private readonly screen = new Scene();
  private readonly geometry: BufferGeometry;
  private readonly materials: RawShaderMaterial[] = [];
  private readonly light: RawShaderMaterial;
  private surface: WebGLRenderTarget | null = null;
  private places: DataTexture | null = null; // corners among the visible vertices

  /** shared: uniforms of the look and of the light. */
  constructor(mesh: Mesh, parts: readonly Part[], shared: Record<string, IUniform>) {
    this.nVertex = mesh.nVertex;
    for (const { geometry, material } of parts) {
      const still = new RawShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: material.vertexShader,
        fragmentShader: material.fragmentShader,
        defines: { ...material.defines, STILL: 1 },
        side: material.side,
      });
      still.uniforms = material.uniforms; // not copies
      this.materials.push(still);
      this.scene.add(drawn(geometry, still));
    }
    const [first] = parts; // each has the attributes and the index of all
    this.geometry = cornersGeometry(mesh, first?.geometry ?? new BufferGeometry());
    const outline = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: cornersVertex,
      fragmentShader: cornersFragment,
      side: first?.material.side ?? FrontSide,
    });
    this.outline.add(drawn(this.geometry, outline));
    this.light = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: screenVertex,
      fragmentShader: litFragment,
      defines: { VERTEX_WIDTH, N_SINGLE: 0, N_EXIT: 0 },
      depthFunc: AlwaysDepth, // what follows is drawn behind it
      uniforms: {
        ...shared,
        ...Object.fromEntries(
          ["corners", "still0", "still1", "still2", "still3"].map((name) => [
            name,
            { value: null },
          ]),
        ),
        vertexColors: { value: null },
      },
    });
    this.materials.push(outline, this.light);
    this.screen.add(screenTriangle(this.light));
  }

  /** Draws what this eye sees, and finds the visible vertices. */
  async begin(
    renderer: WebGLRenderer,
    camera: Camera,
    width: number,
    height: number,
  ): Promise<void> {
    this.forget();
    const surface = (this.surface = new WebGLRenderTarget(width, height, {
      count: 4,
      type: HalfFloatType,
      format: RGBAFormat,
      colorSpace: LinearSRGBColorSpace,
      minFilter: NearestFilter,
      magFilter: NearestFilter,
    }));
    const seen = new WebGLRenderTarget(width, height, {
      type: UnsignedIntType,
      format: RGBAIntegerFormat,
      internalFormat: "RGBA32UI",
      minFilter: NearestFilter,
      magFilter: NearestFilter,
    });
    const words = new Uint32Array(4 * width * height);
    try {
      this.drawOnce(renderer, surface, this.scene, camera);
      this.drawOnce(renderer, seen, this.outline, camera);
      await renderer.readRenderTargetPixelsAsync(seen, 0, 0, width, height, words);
    } catch (error) {
      if (this.surface === surface) this.forget();
      throw error;
    } finally {
      seen.dispose();
    }
    complete = true;
    if (this.surface !== surface) return; // disposed of, or begun again
    const visible = seenVertices(words, this.nVertex);
    const places = new DataTexture(words, width, height, RGBAIntegerFormat, UnsignedIntType);
    places.internalFormat = "RGBA32UI";
    places.minFilter = places.magFilter = NearestFilter;
    places.needsUpdate = true;
    this.places = places;
    const u = this.light.uniforms;
    if (u.corners) u.corners.value = places;
    surface.textures.forEach((texture, i) => {
      const still = u[`still${i}`];
      if (still) still.value = texture;
    });
    this.visible = visible;
  }

  // Throws where the browser can't draw into the target.
  private drawOnce(
    renderer: WebGLRenderer,
    target: WebGLRenderTarget,
    scene: Scene,
    camera: Camera,
  ): void {
    const gl = renderer.getContext();
    renderer.setRenderTarget(target);
    const drawable =
      complete || gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
    if (drawable) {
      renderer.setClearColor(0, 0);
      renderer.clear();
      renderer.render(scene, camera);
    }
    renderer.setRenderTarget(null);
    renderer.setClearColor(0, 1);
    if (!drawable) throw new Error("no target of this format");
  }

  /** Which faces of the surface are drawn, from now on. */
  setSide(side: Side): void {
    for (const material of this.materials) if (material !== this.light) material.side = side;
    this.forget();
  }

  /** Draws the surface into the target that is set, with these colours of the visible vertices. */
  draw(renderer: WebGLRenderer, { texture, layers, exits }: VertexTexture): void {
    const { vertexColors } = this.light.uniforms;
    const defines = this.light.defines as Record<string, number>;
    const nSingle = layers - 1 - exits;
    if (vertexColors) vertexColors.value = texture;
    if (defines.N_SINGLE !== nSingle || defines.N_EXIT !== exits) {
      Object.assign(defines, { N_SINGLE: nSingle, N_EXIT: exits });
      this.light.needsUpdate = true;
    }
    renderer.render(this.screen, new Camera());
  }

  private forget(): void {
    this.surface?.dispose();
    this.places?.dispose();
    this.surface = this.places = this.visible = null;
  }

  dispose(): void {
    this.forget();
    this.geometry.dispose();
    for (const material of this.materials) material.dispose();
  }
}

function drawn(geometry: BufferGeometry, material: RawShaderMaterial): ThreeMesh {
  const mesh = new ThreeMesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}
