// SPDX-License-Identifier: MIT
import { create } from "@bufbuild/protobuf";
import { expect, test } from "vitest";
import { ColorFormat, ColorsAnswerSchema } from "../src/gen/relight_pb";
import { VERTEX_WIDTH } from "../src/scene/shaders";
import { colorsOf, VertexColors } from "../src/scene/vertex-colors";

const answer = (format: ColorFormat) =>
  create(ColorsAnswerSchema, { format, nVertex: 3, nPart: 2, nExit: 1 });
const dataOf = (texture: unknown) =>
  (texture as { image: { data: Uint32Array | Uint16Array } }).image.data;

test("colours of some vertices lie in the order of their list, layer after layer", () => {
  const packed = colorsOf(
    answer(ColorFormat.COLOR_RGB9E5),
    new Uint8Array(Uint32Array.from([1, 2, 3, 11, 12, 13]).buffer),
  );
  const colors = new VertexColors();
  const { texture, layers, exits } = colors.put(packed, Uint32Array.from([2, 0]));
  expect([layers, exits]).toEqual([2, 1]);
  expect(Array.from(dataOf(texture).subarray(0, 2))).toEqual([3, 1]);
  expect(Array.from(dataOf(texture).subarray(VERTEX_WIDTH, VERTEX_WIDTH + 2))).toEqual([
    13, 11,
  ]);
  const half = colorsOf(
    answer(ColorFormat.COLOR_F16),
    new Uint8Array(Uint16Array.from({ length: 18 }, (_, i) => i).buffer),
  );
  const all = dataOf(colors.put(half, null).texture);
  expect(Array.from(all.subarray(0, 9))).toEqual([0, 1, 2, 3, 4, 5, 6, 7, 8]);
  const one = dataOf(colors.put(half, Uint32Array.from([1])).texture);
  expect(Array.from(one.subarray(0, 3))).toEqual([3, 4, 5]);
  colors.dispose();
});

test("a payload that ends too early is refused", () => {
  expect(() => colorsOf(answer(ColorFormat.COLOR_RGB9E5), new Uint8Array(20))).toThrow();
});
