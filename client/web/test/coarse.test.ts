// SPDX-License-Identifier: MIT
import { create } from "@bufbuild/protobuf";
import { expect, test } from "vitest";
import { ColorFormat, ColorsAnswerSchema, GeometryAnswerSchema } from "../src/gen/relight_pb";
import { expanded, orderOf } from "../src/scene/coarse-order";

// Four vertices: 2 and 0 are roots, 3 is between them, 1 between 3 and 0.
function order(parents: number[]) {
  const payload = new Uint8Array(64 + 32);
  new Uint32Array(payload.buffer, 0, 4).set([2, 0, 3, 1]);
  new Uint32Array(payload.buffer, 64, 8).set(parents);
  const answer = create(GeometryAnswerSchema, {
    nVertex: 4,
    nCoarseRoot: 2,
    coarseParentsOffset: 64n,
    coarseOrder: 7n,
  });
  return { answer, payload };
}
const GOOD = [0, 0, 1, 1, 0, 1, 2, 1];

test("vertices that were left out are the mean of their parents, in each part", () => {
  const { answer, payload } = order(GOOD);
  const packed = (mantissa: number) => (24 << 27) | mantissa; // red
  const sent = new Uint32Array([packed(8), packed(4), packed(2), packed(0)]);
  const colors = create(ColorsAnswerSchema, {
    nVertex: 4,
    nPart: 2,
    format: ColorFormat.COLOR_RGB9E5,
    nCoarse: 2,
    coarseOrder: 7n,
  });
  const all = expanded(orderOf(answer, payload), colors, new Uint8Array(sent.buffer));
  expect([...all].filter((_, i) => i % 3 === 0)).toEqual([4, 5, 8, 6, 0, 0.5, 2, 1]);
  expect([...all].filter((_, i) => i % 3 === 1).every((green) => green === 0)).toBe(true);
});

test("an order whose parents do not come first, and another order's colours, are refused", () => {
  const late = order([0, 0, 1, 1, 2, 1, 2, 1]);
  expect(() => orderOf(late.answer, late.payload)).toThrow("contradicts");
  const { answer, payload } = order(GOOD);
  const colors = create(ColorsAnswerSchema, { nVertex: 4, nCoarse: 2, coarseOrder: 8n });
  expect(() => expanded(orderOf(answer, payload), colors, new Uint8Array(64))).toThrow("order");
});
