// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { dipoleErrorOf, isByWalks, placesOf, spread } from "../src/scene/error-map";

const text = (vertex: unknown, error: unknown) => JSON.stringify({ places: { vertex, error } });

test("places of a bake's errors; of texts that are none, nothing", () => {
  expect(placesOf(text([3, 0], [0.01, 0]), 4)).toEqual({ vertex: [3, 0], error: [0.01, 0] });
  for (const bad of [
    "",
    "{",
    "null",
    "{}",
    text([3], [0.1, 0.2]),
    text([], []),
    text([4], [0.1]),
    text([-1], [0.1]),
    text([0.5], [0.1]),
    text([1], [-0.1]),
    text([1], ["0.1"]),
    text("1", "2"),
  ])
    expect(placesOf(bad, 4), bad).toBeNull();
});

test("errors at their places, and between them the mean of the nearest", () => {
  const at = Float32Array.from([0, 0, 0, 2, 0, 0, 0, 90, 0, 0, 91, 0, 0, 92, 0]);
  const error = [0.1, 0.3, 9, 9, 9];
  const found = spread([0, 0, 0, 2, 0, 0, 1, 0, 0, 0, 92, 0], at, error);
  expect(found[0]).toBeCloseTo(0.1, 6);
  expect(found[1]).toBeCloseTo(0.3, 6);
  expect(found[2]).toBeCloseTo(0.2, 1);
  expect(found[3]).toBeCloseTo(9, 6);
  expect(spread([5, 5, 5], Float32Array.from([0, 0, 0]), [0.4])[0]).toBeCloseTo(0.4, 6);
});

test("the dipole against walks; of texts that have none, nothing", () => {
  const dipole = {
    sky: 0.2,
    boxes: 0.3,
    sun: 0.3,
    darkest: -0.3,
    brightest: 0.1,
    ratio: [-0.25, 0.5],
  };
  const places = { vertex: [3, 0], error: [0, 0] };
  const found = dipoleErrorOf(JSON.stringify({ places, dipole }), 4);
  expect(found).toEqual({
    rms: 0.2,
    darkest: -0.3,
    brightest: 0.1,
    places: { vertex: [3, 0], error: [-0.25, 0.5] },
  });
  for (const bad of [
    "{",
    JSON.stringify({ places }),
    JSON.stringify({ dipole }),
    JSON.stringify({ places, dipole: { ...dipole, ratio: [0.1] } }),
    JSON.stringify({ places, dipole: { ...dipole, ratio: [0.1, -1.5] } }),
    JSON.stringify({ places, dipole: { ...dipole, sky: null } }),
  ])
    expect(dipoleErrorOf(bad, 4), bad).toBeNull();
  expect(isByWalks('{"scattering":"walk"}')).toBe(true);
  for (const not of ["", "{", "{}", '{"scattering":"dipole"}'])
    expect(isByWalks(not)).toBe(false);
});
