// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { seenVertices } from "../src/scene/still-surface";

test("each vertex that is seen is listed once, and corners are places in the list", () => {
  // Four pixels: beside the model, two triangles with a side in common, the first again.
  const corners = Uint32Array.from([0, 0, 0, 0, 7, 2, 5, 11, 5, 2, 9, 12, 7, 2, 5, 13]);
  expect(Array.from(seenVertices(corners, 10))).toEqual([7, 2, 5, 9]);
  expect(Array.from(corners)).toEqual([0, 0, 0, 0, 0, 1, 2, 11, 2, 1, 3, 12, 0, 1, 2, 13]);
});
