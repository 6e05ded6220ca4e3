// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { apart, seenVertices } from "../src/scene/still-surface";

test("each vertex that is seen is listed once, and corners are places in the list", () => {
  // Four pixels: beside the model, two triangles with a side in common, the first again.
  const corners = Uint32Array.from([0, 0, 0, 0, 7, 2, 5, 11, 5, 2, 9, 12, 7, 2, 5, 13]);
  expect(Array.from(seenVertices(corners, 10))).toEqual([7, 2, 5, 9]);
  expect(Array.from(corners)).toEqual([0, 0, 0, 0, 0, 1, 2, 11, 2, 1, 3, 12, 0, 1, 2, 13]);
});

test("each corner has its place and knows the vertices of its triangle", () => {
  const positions = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1];
  const index = [2, 0, 1, 1, 3, 2];
  const { at, triangle } = apart(index, positions, null);
  expect(Array.from(at.subarray(0, 9))).toEqual([0, 1, 0, 0, 0, 0, 1, 0, 0]);
  expect(Array.from(triangle)).toEqual([2, 0, 1, 2, 0, 1, 2, 0, 1, 1, 3, 2, 1, 3, 2, 1, 3, 2]);
  // Vertex 3 is one side of a seam at 0.
  const seam = apart(index, positions, [0, 1, 2, 0]);
  expect(Array.from(seam.triangle.subarray(9, 12))).toEqual([1, 0, 2]);
  expect(Array.from(seam.at.subarray(12, 15))).toEqual([0, 0, 1]);
});
