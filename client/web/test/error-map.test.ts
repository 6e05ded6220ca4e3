// SPDX-License-Identifier: MIT
// The errors of a bake and of the dipole, as ModelInfo.errors has them.
import { expect, test } from "vitest";
import { dipoleErrorOf, placesOf, spread } from "../src/scene/error-map";

const text = (vertex: unknown, error: unknown, dipole?: object) =>
  JSON.stringify({ places: { vertex, error }, ...(dipole ? { dipole } : {}) });
const sky = { sky: 0.12, darkest: -0.4, brightest: 0.7 };

test("a dipole may be darker than walks, but no light is negative", () => {
  const found = dipoleErrorOf(
    text([0, 3, 4], [0, 0.1, 0.2], { ...sky, ratio: [-0.4, 0, 0.7] }),
    5,
  );
  expect(found).toEqual({
    rms: 0.12,
    darkest: -0.4,
    brightest: 0.7,
    places: { vertex: [0, 3, 4], error: [-0.4, 0, 0.7] },
  });
  const black = text([0], [0], { ...sky, ratio: [-1.01] });
  expect(dipoleErrorOf(black, 5)).toBeNull();
});

test("errors of a bake are not negative, and are of vertices that there are", () => {
  expect(placesOf(text([0, 4], [0, 0.5]), 5)).toEqual({ vertex: [0, 4], error: [0, 0.5] });
  for (const [vertex, error] of [
    [[0], [-0.1]],
    [[5], [0]],
    [[-1], [0]],
    [[0.5], [0]],
    [[0, 1], [0]],
    [[], []],
    ["0", [0]],
  ])
    expect(placesOf(text(vertex, error), 5)).toBeNull();
  for (const none of ["", "{", "null", "{}"]) {
    expect(placesOf(none, 5)).toBeNull();
    expect(dipoleErrorOf(none, 5)).toBeNull();
  }
});

test("between places errors are interpolated: each has its own, an even one is even", () => {
  const at = Float32Array.from([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 5, 5, 5, -3, 0, 0]);
  const error = [0.3, 0.1, 0.6, 0.2, 0.9, 0.4];
  spread(at, at, error).forEach((e, i) => expect(e).toBeCloseTo(error[i] ?? 0, 5));
  const points = [0.2, 0.3, 0.1, -1, 2, 0.4, 9, 9, 9];
  spread(
    points,
    at,
    error.map(() => 0.25),
  ).forEach((e) => expect(e).toBeCloseTo(0.25, 6));
  const [middle = 0] = spread([0.5, 0, 0], at.subarray(0, 6), error.slice(0, 2));
  expect(middle).toBeCloseTo(0.2, 6);
});
