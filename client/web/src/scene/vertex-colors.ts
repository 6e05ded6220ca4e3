// SPDX-License-Identifier: MIT
// Colours of all vertices as an array texture, which the surface's vertex shader reads: layer 0
// is M of PROTOCOL.md (COLORS), layer 1 + k is S_k. VERTEX_WIDTH vertices a row.
import {
  DataArrayTexture,
  HalfFloatType,
  NearestFilter,
  RGBFormat,
  UnsignedInt5999Type,
  type Texture,
} from "three";
import { ColorFormat, type ColorsAnswer } from "../gen/relight_pb";
import { halves, words } from "../protocol/frame";
import { VERTEX_WIDTH } from "./shaders";

/** A texture of the vertices' colours. */
export interface VertexTexture {
  texture: Texture;
  /** Layers: M, and S_0 and on where single scattering comes apart. */
  layers: number;
}

export function rowsOf(nVertex: number): number {
  return Math.max(1, Math.ceil(nVertex / VERTEX_WIDTH));
}

export class VertexColors {
  private made: DataArrayTexture | null = null;
  private format = ColorFormat.COLOR_RGB9E5;

  /** The colours of an answer in RGB9E5 or halves; throws where its payload ends too early. */
  take(answer: ColorsAnswer, payload: Uint8Array): VertexTexture {
    const n = answer.nVertex;
    const layers = Math.max(1, answer.nPart);
    const half = answer.format === ColorFormat.COLOR_F16;
    const values = half ? halves(payload, 0, 3 * n * layers) : words(payload, 0, n * layers);
    const texture = this.textureOf(answer.format, rowsOf(n), layers);
    const data = texture.image.data as unknown as Uint32Array | Uint16Array;
    const each = half ? 3 * n : n;
    for (let i = 0; i < layers; i++)
      data.set(values.subarray(i * each, (i + 1) * each), (i * data.length) / layers);
    texture.needsUpdate = true;
    return { texture, layers };
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
    const half = format === ColorFormat.COLOR_F16;
    const size = VERTEX_WIDTH * rows * layers;
    const data = half ? new Uint16Array(3 * size) : new Uint32Array(size);
    const made = new DataArrayTexture(
      data as unknown as Uint8Array<ArrayBuffer>,
      VERTEX_WIDTH,
      rows,
      layers,
    );
    made.format = RGBFormat;
    made.type = half ? HalfFloatType : UnsignedInt5999Type;
    made.internalFormat = half ? "RGB16F" : "RGB9_E5";
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
