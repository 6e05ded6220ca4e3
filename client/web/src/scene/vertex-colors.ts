// SPDX-License-Identifier: MIT
// Colours of all vertices as an array texture, which the surface's vertex shader reads: layer 0
// is M of PROTOCOL.md (COLORS), layer 1 + k is S_k, the planes of exit follow. VERTEX_WIDTH
// vertices a row.
import {
  DataArrayTexture,
  FloatType,
  HalfFloatType,
  NearestFilter,
  RGBFormat,
  UnsignedInt5999Type,
  type PixelFormatGPU,
  type Texture,
  type TextureDataType,
} from "three";
import { ColorFormat, type ColorsAnswer } from "../gen/relight_pb";
import { halves, words } from "../protocol/frame";
import { rowsAt } from "./geometry";
import { VERTEX_WIDTH } from "./shaders";

/** A texture of the vertices' colours. */
export interface VertexTexture {
  texture: Texture;
  /** Layers: M, S_0 and on where single scattering comes apart, and the planes of exit. */
  layers: number;
  /** Planes of exit among them, the last. */
  exits: number;
}

export function rowsOf(nVertex: number): number {
  return Math.max(1, Math.ceil(nVertex / VERTEX_WIDTH));
}

interface Store {
  type: TextureDataType;
  internalFormat: PixelFormatGPU;
  data: Uint32Array | Uint16Array | Float32Array;
}
const packed = (size: number): Store => ({
  type: UnsignedInt5999Type,
  internalFormat: "RGB9_E5",
  data: new Uint32Array(size),
});
const STORES: Partial<Record<ColorFormat, (size: number) => Store>> = {
  [ColorFormat.COLOR_F16]: (size) => ({
    type: HalfFloatType,
    internalFormat: "RGB16F",
    data: new Uint16Array(3 * size),
  }),
  [ColorFormat.COLOR_F32]: (size) => ({
    type: FloatType,
    internalFormat: "RGB32F",
    data: new Float32Array(3 * size),
  }),
};

/** Colours of an answer, layer after layer. */
export interface Colors {
  format: ColorFormat;
  values: Uint32Array | Uint16Array | Float32Array;
  nVertex: number;
  layers: number;
  exits: number;
}

/** The colours of an answer in RGB9E5 or halves, or those that were made of one; throws where its payload
 * ends too early. */
export function colorsOf(
  answer: ColorsAnswer,
  payload: Uint8Array,
  made?: Float32Array,
): Colors {
  const { nVertex, nExit } = answer;
  const layers = Math.max(1, answer.nPart);
  const half = answer.format === ColorFormat.COLOR_F16;
  const values =
    made ??
    (half ? halves(payload, 0, 3 * nVertex * layers) : words(payload, 0, nVertex * layers));
  const format = made ? ColorFormat.COLOR_F32 : answer.format;
  return { format, values, nVertex, layers, exits: nExit };
}

export class VertexColors {
  private made: DataArrayTexture | null = null;
  private format = ColorFormat.COLOR_RGB9E5;

  /** The colours of all vertices, or of those of a list, in its order. */
  put(
    { format, values, nVertex, layers, exits }: Colors,
    vertices: Uint32Array | null,
  ): VertexTexture {
    const texture = this.textureOf(format, rowsOf(vertices?.length ?? nVertex), layers);
    const data = texture.image.data as unknown as Uint32Array | Uint16Array | Float32Array;
    const width = STORES[format] ? 3 : 1; // numbers a vertex
    const each = nVertex * width;
    for (let i = 0; i < layers; i++) {
      const layer = values.subarray(i * each, (i + 1) * each);
      const wanted = vertices ? rowsAt(layer, width, vertices) : layer;
      data.set(wanted, (i * data.length) / layers);
    }
    texture.needsUpdate = true;
    return { texture, layers, exits };
  }

  private textureOf(format: ColorFormat, rows: number, layers: number): DataArrayTexture {
    const old = this.made;
    if (
      old &&
      format === this.format &&
      old.image.height === rows &&
      old.image.depth === layers
    )
      return old;
    old?.dispose();
    const size = VERTEX_WIDTH * rows * layers;
    const { type, internalFormat, data } = STORES[format]?.(size) ?? packed(size);
    const made = new DataArrayTexture(
      data as unknown as Uint8Array<ArrayBuffer>,
      VERTEX_WIDTH,
      rows,
      layers,
    );
    made.format = RGBFormat;
    made.type = type;
    made.internalFormat = internalFormat;
    made.minFilter = made.magFilter = NearestFilter;
    made.unpackAlignment = 1;
    this.format = format;
    return (this.made = made);
  }

  dispose(): void {
    this.made?.dispose();
    this.made = null;
  }
}
