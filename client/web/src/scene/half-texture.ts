// SPDX-License-Identifier: MIT
// Array textures of half floats, RGBA, square layers.
import {
  DataArrayTexture,
  DataUtils,
  HalfFloatType,
  LinearFilter,
  LinearSRGBColorSpace,
  RGBAFormat,
} from "three";

export function halfTexture(side: number, layers: number): DataArrayTexture {
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
export function fillHalf(texture: DataArrayTexture, values: Float32Array): void {
  const data = texture.image.data as Uint16Array;
  for (let i = 0; i < data.length; i++)
    data[i] = DataUtils.toHalfFloat(Math.min(values[i] ?? 0, 65504));
  texture.needsUpdate = true;
}
