// SPDX-License-Identifier: MIT
// Coefficients into vertex colours on the GPU (PROTOCOL, FACTORS): one fragment a vertex sums the
// rows of its cluster into a texture that the surface's vertex shader reads.
import {
  Camera,
  DataTexture,
  DataUtils,
  GLSL3,
  HalfFloatType,
  NearestFilter,
  RawShaderMaterial,
  RGBAFormat,
  RGBAIntegerFormat,
  RGIntegerFormat,
  Scene,
  ShortType,
  UnsignedIntType,
  WebGLArrayRenderTarget,
  type PixelFormat,
  type PixelFormatGPU,
  type TextureDataType,
  type WebGLRenderer,
} from "three";
import { ADDITIVE } from "./additive";
import { screenTriangle } from "./screen-triangle";
import {
  ColorFormat,
  Term,
  type Coefficients,
  type ColorsAnswer,
  type FactorsAnswer,
} from "../gen/relight_pb";
import { halves, shorts, words } from "../protocol/frame";
import { rowsAt } from "./geometry";
import { rowsOf, type VertexTexture } from "./vertex-colors";
import { FACTOR_WIDTH, factorFragment, factorVertex, ROW_WIDTH, VERTEX_WIDTH } from "./shaders";

const U_SCALE = 2 ** -20;

interface Tensor {
  term: Term;
  /** Planes of exit, which follow the phases of single scattering. */
  exit: boolean;
  factors: DataTexture;
  clusters: Uint32Array;
  order: Uint32Array;
  /** placesOf() by the most rows of a cluster. */
  places: Map<number, Uint32Array>;
}
/** Vertices whose values are wanted, with what finds and holds them. */
interface Selection {
  /** null: all. */
  vertices: Uint32Array | null;
  target: WebGLArrayRenderTarget | null;
  /** Where the vertices find their factors, by tensor and by the most rows of a cluster. */
  places: Map<string, DataTexture>;
}
const selectionOf = (vertices: Uint32Array | null): Selection => ({
  vertices,
  target: null,
  places: new Map<string, DataTexture>(),
});
function disposeOf({ target, places }: Selection): void {
  target?.dispose();
  for (const texture of places.values()) texture.dispose();
}

const placesTexture = (places: Uint32Array): DataTexture =>
  texture(places, VERTEX_WIDTH, RGBAIntegerFormat, UnsignedIntType, "RGBA32UI", 4);

function texture(
  data: Int16Array | Uint32Array | Uint16Array,
  width: number,
  format: PixelFormat,
  type: TextureDataType,
  internalFormat: PixelFormatGPU,
  perTexel: number,
): DataTexture {
  const height = Math.max(1, Math.ceil(data.length / perTexel / width));
  const all = new (data.constructor as new (n: number) => typeof data)(
    width * height * perTexel,
  );
  all.set(data);
  const made = new DataTexture(
    all as unknown as Uint8Array<ArrayBuffer>,
    width,
    height,
    format,
    type,
  );
  made.internalFormat = internalFormat;
  made.minFilter = made.magFilter = NearestFilter;
  made.unpackAlignment = 1;
  made.needsUpdate = true;
  return made;
}

/** Where each vertex finds its factors: first texel, texels between two pairs of columns, rank,
 * first row. [n_vertex][4] mostRank: of coefficients with so many rows of a cluster; 0: with all. */
export function placesOf(
  clusters: Uint32Array,
  order: Uint32Array,
  nVertex: number,
  mostRank = 0,
): { places: Uint32Array; texels: number } {
  const places = new Uint32Array(4 * nVertex);
  let position = 0;
  let texel = 0;
  let row = 0;
  for (let c = 0; c < clusters.length / 2; c++) {
    const n = clusters[2 * c] ?? 0;
    const rank = clusters[2 * c + 1] ?? 0;
    const rows = mostRank ? Math.min(rank, mostRank) : rank;
    const stride = 16 * Math.ceil(n / 16);
    for (let p = 0; p < n; p++) {
      const vertex = order[position + p] ?? 0;
      if (vertex < nVertex) places.set([texel + p, stride, rows, row], 4 * vertex);
    }
    position += n;
    texel += Math.ceil(rank / 2) * stride;
    row += rows;
  }
  return { places, texels: texel };
}

/** Words of COEFFICIENTS_PACKED (PROTOCOL.md), an even number, as halves: these hold the numbers
 * exactly. */
export function unpackRows(packed: Uint32Array): Uint16Array {
  const out = new Uint16Array(3 * packed.length);
  for (let i = 0; i < packed.length; i++) {
    const [low = 0, high = 0] = packed.subarray(i & ~1, (i & ~1) + 2);
    const step = 2 ** (((low >>> 30) | ((high >>> 30) << 2)) - 9);
    const x = i & 1 ? high : low;
    for (let c = 0; c < 3; c++) {
      const mantissa = (x << (22 - 10 * c)) >> 22; // with its sign
      out[3 * i + c] = DataUtils.toHalfFloat(mantissa * step);
    }
  }
  return out;
}

export class Factors {
  readonly hash: bigint;
  private readonly tensors: Tensor[];
  private readonly nVertex: number;
  private readonly whole = selectionOf(null);
  private part = selectionOf(new Uint32Array(0));
  private readonly scene = new Scene();
  private readonly camera = new Camera();
  private readonly material: RawShaderMaterial;
  private rows: DataTexture | null = null;

  /** Throws where the sections contradict each other. */
  constructor(answer: FactorsAnswer, payload: Uint8Array) {
    this.hash = answer.factors;
    const n = (this.nVertex = answer.nVertex);
    this.tensors = answer.tensors.map((tensor) => {
      const clusters = words(payload, Number(tensor.clustersOffset), 2 * tensor.nCluster);
      const order = words(payload, Number(tensor.orderOffset), n);
      const { places, texels } = placesOf(clusters, order, n);
      if (texels * 4 !== Number(tensor.uBytes))
        throw new Error("the clusters of FACTORS contradict its size");
      const u = shorts(payload, Number(tensor.uOffset), 2 * texels);
      return {
        term: tensor.term,
        exit: tensor.exit,
        factors: texture(u, FACTOR_WIDTH, RGIntegerFormat, ShortType, "RG16I", 2),
        clusters: clusters.slice(), // the payload is free to go
        order: order.slice(),
        places: new Map([[0, places]]),
      };
    });
    this.material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: factorVertex,
      fragmentShader: factorFragment,
      defines: { FACTOR_WIDTH: `${FACTOR_WIDTH}u`, ROW_WIDTH: `${ROW_WIDTH}u` },
      ...ADDITIVE,
      uniforms: {
        factors: { value: null },
        places: { value: null },
        rows: { value: null },
        scale: { value: 1 },
      },
    });
    this.scene.add(screenTriangle(this.material));
  }

  private targetOf(selection: Selection, layers: number): WebGLArrayRenderTarget {
    if (selection.target?.depth === layers) return selection.target;
    selection.target?.dispose();
    const n = selection.vertices?.length ?? this.nVertex;
    return (selection.target = new WebGLArrayRenderTarget(VERTEX_WIDTH, rowsOf(n), layers, {
      type: HalfFloatType,
      minFilter: NearestFilter,
      magFilter: NearestFilter,
      depthBuffer: false,
    }));
  }
  private selected(vertices: Uint32Array | null): Selection {
    if (!vertices) return this.whole;
    if (this.part.vertices !== vertices) {
      disposeOf(this.part);
      this.part = selectionOf(vertices);
    }
    return this.part;
  }
  private singleLayers(light: Coefficients): number {
    return this.mostPhases(light, ({ term, exit }) => term === Term.SINGLE && !exit);
  }
  private mostPhases(light: Coefficients, wanted: (tensor: Tensor) => boolean): number {
    return light.layers.reduce((most, { tensor: index, nPhase }) => {
      const tensor = this.tensors[index];
      return tensor && wanted(tensor) ? Math.max(most, nPhase) : most;
    }, 0);
  }

  /** The values under a light of all vertices, or of those of a list, in its order; planes of lights are
   * summed. They live until the next call of the same kind. */
  multiply(
    renderer: WebGLRenderer,
    light: Coefficients,
    { format, nPlane, planeBytes }: ColorsAnswer,
    payload: Uint8Array,
    vertices: Uint32Array | null = null,
  ): VertexTexture {
    const exits = this.mostPhases(light, (tensor) => tensor.exit);
    const single = this.singleLayers(light);
    const layers = 1 + single + exits;
    const selection = this.selected(vertices);
    const target = this.targetOf(selection, layers);
    renderer.setClearColor(0, 0);
    for (let i = 0; i < layers; i++) {
      renderer.setRenderTarget(target, i);
      renderer.clear();
    }
    for (let plane = 0; plane < nPlane; plane++)
      for (const layer of light.layers) {
        const at = plane * Number(planeBytes) + Number(layer.offset);
        const n = layer.nRow * layer.nPhase;
        const rows =
          format === ColorFormat.COLOR_COEFFICIENTS_PACKED
            ? unpackRows(words(payload, at, n + (n % 2)))
            : halves(payload, at, 3 * n);
        const tensor = this.tensors[layer.tensor];
        if (!tensor) continue;
        const places = this.placesFor(selection, layer.tensor, tensor, light.mostRank);
        const first = tensor.exit ? 1 + single : tensor.term === Term.SINGLE ? 1 : 0;
        for (let phase = 0; phase < layer.nPhase; phase++) {
          this.fillRows(rows, layer.nRow, layer.nPhase, phase);
          const scale = (layer.scales[plane] ?? 1) * U_SCALE;
          renderer.setRenderTarget(target, first + phase);
          this.addLayer(renderer, tensor, places, scale);
        }
      }
    renderer.setRenderTarget(null);
    renderer.setClearColor(0, 1);
    return { texture: target.texture, layers, exits };
  }

  private placesFor(
    selection: Selection,
    index: number,
    tensor: Tensor,
    mostRank: number,
  ): DataTexture {
    const key = `${index} ${mostRank}`;
    const old = selection.places.get(key);
    if (old) return old;
    const { clusters, order } = tensor;
    const places =
      tensor.places.get(mostRank) ?? placesOf(clusters, order, this.nVertex, mostRank).places;
    tensor.places.set(mostRank, places);
    const { vertices } = selection;
    const made = placesTexture(vertices ? rowsAt(places, 4, vertices) : places);
    selection.places.set(key, made);
    return made;
  }

  private addLayer(
    renderer: WebGLRenderer,
    { factors }: Tensor,
    places: DataTexture,
    scale: number,
  ): void {
    const u = this.material.uniforms;
    if (u.factors) u.factors.value = factors;
    if (u.places) u.places.value = places;
    if (u.rows) u.rows.value = this.rows;
    if (u.scale) u.scale.value = scale;
    renderer.render(this.scene, this.camera);
  }

  // One phase of each row, as texels of four halves.
  private fillRows(from: Uint16Array, nRow: number, nPhase: number, phase: number): void {
    const height = Math.max(1, Math.ceil(nRow / ROW_WIDTH));
    if (!this.rows || this.rows.image.height < height) {
      this.rows?.dispose();
      this.rows = texture(
        new Uint16Array(ROW_WIDTH * height * 4),
        ROW_WIDTH,
        RGBAFormat,
        HalfFloatType,
        "RGBA16F",
        4,
      );
    }
    const to = this.rows.image.data as unknown as Uint16Array;
    for (let row = 0; row < nRow; row++)
      for (let c = 0; c < 3; c++) to[4 * row + c] = from[3 * (row * nPhase + phase) + c] ?? 0;
    this.rows.needsUpdate = true;
  }

  dispose(): void {
    for (const { factors } of this.tensors) factors.dispose();
    disposeOf(this.whole);
    disposeOf(this.part);
    this.rows?.dispose();
    this.material.dispose();
  }
}
