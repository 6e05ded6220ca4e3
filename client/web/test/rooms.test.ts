// SPDX-License-Identifier: MIT
import { create } from "@bufbuild/protobuf";
import { describe, expect, test } from "vitest";
import { DecisionSchema, SeenSchema, SurfacePointSchema } from "../src/gen/relight_pb";
import { anchorOf, fitsMesh, nearestInTriangle, sameMesh } from "../src/room/anchor";
import { pick, project } from "../src/room/pick";
import { placedOf } from "../src/room/convert";
import { stands, verdict, type Made } from "../src/room/verdict";
import { builtinFile, rgbe } from "../src/room/hdr";
import type { Placed, Vec3 } from "../src/scene/camera";
import type { Mesh } from "../src/scene/geometry";

// A unit octahedron, each side split n times along its edges.
function octahedron(n: number, hash: string): Mesh {
  const positions: number[] = [];
  const triangles: number[] = [];
  for (const sx of [1, -1])
    for (const sy of [1, -1])
      for (const sz of [1, -1]) {
        const at = (i: number, j: number): Vec3 => [
          (sx * i) / n,
          (sy * j) / n,
          (sz * (n - i - j)) / n,
        ];
        const add = (a: Vec3, b: Vec3, c: Vec3) => {
          const first = positions.length / 3;
          positions.push(...a, ...(sx * sy * sz > 0 ? [...b, ...c] : [...c, ...b]));
          triangles.push(first, first + 1, first + 2);
        };
        for (let i = 0; i < n; i++)
          for (let j = 0; i + j < n; j++) {
            add(at(i, j), at(i + 1, j), at(i, j + 1));
            if (i + j + 1 < n) add(at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
          }
      }
  return {
    nVertex: positions.length / 3,
    positions: Float32Array.from(positions),
    normals: new Float32Array(positions.length),
    triangles: Uint32Array.from(triangles),
    uv: [],
    cornerUv: null,
    tint: null,
    blocked: null,
    parts: [],
    frame: { centre: [0, 0, 0], radius: 1 },
    mmPerUnit: 1,
    split: 0,
    generation: 1n,
    hash,
    gained: false,
  };
}
const point = (triangle: number, b1: number, b2: number, [x, y, z]: Vec3) =>
  create(SurfacePointSchema, { triangle, b1, b2, position: { x, y, z } });
const EYE: Placed = { eye: [0.2, 0.3, 5], target: [0, 0, 0], up: [0, 1, 0], fovyDeg: 36 };

describe("points of a surface", () => {
  test("what is picked is projected where it was", () => {
    const mesh = octahedron(4, "a");
    for (const [x, y] of [
      [320, 240],
      [300, 200],
      [350, 260],
    ] as const) {
      const found = pick(mesh, EYE, x, y, 640, 480);
      expect(found).not.toBeNull();
      if (!found) continue;
      const [px, py, pz] = found.position;
      expect(Math.abs(px) + Math.abs(py) + Math.abs(pz)).toBeCloseTo(1, 5);
      expect(pz).toBeGreaterThan(0); // the near side
      const at = project(EYE, found.position, 640, 480);
      expect(at?.x).toBeCloseTo(x, 3);
      expect(at?.y).toBeCloseTo(y, 3);
    }
    expect(pick(mesh, EYE, 2, 2, 640, 480)).toBeNull();
  });

  test("a camera without an eye is not placed", () => {
    expect(placedOf(undefined)).toBeNull();
  });
});

describe("lights of the page as files", () => {
  test("three mantissas share an exponent", () => {
    expect(rgbe([1, 0.5, 0.25])).toEqual([128, 64, 32, 129]);
    expect(rgbe([0, 0, 0])).toEqual([0, 0, 0, 0]);
    for (const x of [1e-3, 0.7, 0.999, 3, 1000]) {
      const [mantissa, , , exponent] = rgbe([x, 0, 0]);
      const back = ((mantissa + 0.5) / 256) * 2 ** (exponent - 128);
      expect(Math.abs(back / x - 1)).toBeLessThan(1 / 256);
    }
  });
  test("a light that the page does not have has no file", () => {
    expect(builtinFile("page:none")).toBeNull();
  });
});

describe("anchors", () => {
  const coarse = octahedron(1, "a");
  const fine = octahedron(5, "b");
  const on: Vec3 = [0.2, 0.3, 0.5];

  test("the same mesh keeps the triangle, and says when it moved", () => {
    const at = point(0, 0.2, 0.3, on);
    const same = anchorOf(coarse, true, at);
    expect(same.state).toBe("same");
    same.position.forEach((x, i) => expect(x).toBeCloseTo(on[i] ?? 0, 5));
    const moved = {
      ...coarse,
      positions: coarse.positions.map((x, i) => (i % 3 ? x : x + 0.1)),
    };
    const anchor = anchorOf(moved, true, at);
    expect(anchor.state).toBe("moved");
    expect(anchor.position[0]).toBeCloseTo(on[0] + 0.1, 5);
    expect(anchor.distance).toBeCloseTo(0.1 / Math.sqrt(12), 4);
  });

  test("another mesh of the same surface has it by position", () => {
    const anchor = anchorOf(fine, false, point(99999, 0.2, 0.3, on));
    expect(anchor.state).toBe("placed");
    expect(anchor.distance).toBeLessThan(1e-6);
    anchor.normal.forEach((x) => expect(x).toBeCloseTo(1 / Math.sqrt(3), 5));
  });

  test("the nearest point is that of every triangle tried", () => {
    let seed = 1;
    const random = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
    for (let i = 0; i < 200; i++) {
      const p: Vec3 = [random() - 0.5, random() - 0.5, random() - 0.5];
      const size = Math.abs(p[0]) + Math.abs(p[1]) + Math.abs(p[2]);
      const off = 1 + 0.01 * (random() - 0.5); // the surface is at 1
      const near = p.map((x) => (x * off) / size) as Vec3;
      const anchor = anchorOf(fine, false, point(0, 0, 0, near));
      let best = Infinity;
      for (let t = 0; t < fine.triangles.length / 3; t++) {
        const [a, b, c] = [0, 1, 2].map((k) => {
          const v = 3 * (fine.triangles[3 * t + k] ?? 0);
          return [...fine.positions.slice(v, v + 3)] as Vec3;
        }) as [Vec3, Vec3, Vec3];
        const [w1, w2] = nearestInTriangle(near, a, b, c);
        const d = Math.hypot(
          ...[0, 1, 2].map(
            (k) =>
              (near[k] ?? 0) -
              (1 - w1 - w2) * (a[k] ?? 0) -
              w1 * (b[k] ?? 0) -
              w2 * (c[k] ?? 0),
          ),
        );
        best = Math.min(best, d);
      }
      expect(anchor.distance * Math.sqrt(12)).toBeCloseTo(best, 6);
    }
  });

  test("a place that is not there is lost", () => {
    expect(anchorOf(fine, false, point(0, 0, 0, [0.8, 0.8, 0.8])).state).toBe("lost");
    expect(anchorOf(fine, false, point(0, 0, 0, [800, -900, 1e9])).state).toBe("lost");
    expect(anchorOf(fine, false, undefined).state).toBe("lost");
    expect(anchorOf(coarse, true, point(4e9, 0, 0, [9, 9, 9])).state).toBe("lost");
  });

  test("hashes say whether it is the same mesh, models where there is none", () => {
    const seen = (meshHash: string, model: string) => create(SeenSchema, { meshHash, model });
    expect(sameMesh(coarse, "m2", seen("a", "m1"))).toBe(true);
    expect(sameMesh(coarse, "m1", seen("b", "m1"))).toBe(false);
    expect(sameMesh(coarse, "m1", seen("", "m1"))).toBe(true);
    expect(sameMesh(coarse, "m1", undefined)).toBe(false);
    expect(fitsMesh(coarse, [point(0, 0.2, 0.3, on)])).toBe(true);
    expect(fitsMesh(fine, [point(0, 0.2, 0.3, on)])).toBe(false);
  });
});

describe("the verdict of a decision", () => {
  const seen = { revision: 7, model: "m", meshHash: "a", bakeHash: "" };
  const decision = (more: Partial<typeof seen> = {}) =>
    create(DecisionSchema, { approve: true, seen: { ...seen, ...more } });
  const made = (more: Partial<Made> = {}): Made => ({
    model: "m",
    meshHash: "a",
    bakeHash: "",
    ...more,
  });
  test.each([
    [{}, 7, made(), "approved as it is now"],
    [{}, 9, made(), "approved at revision 7, now at 9"],
    [{}, 0, made(), "approved at revision 7, changed since"],
    [{}, 7, made({ bakeHash: "b" }), "approved at revision 7; the model was baked since"],
    [
      { bakeHash: "b" },
      9,
      made({ bakeHash: "c" }),
      "approved at revision 7, now at 9; the model was baked anew since",
    ],
    [{ bakeHash: "b" }, 7, made(), "approved at revision 7; the model has no bake now"],
    [
      {},
      7,
      made({ meshHash: "x" }),
      "approved at revision 7; the model has another shape since",
    ],
    // What is not known is not said: another model, an older daemon, a model that is gone.
    [{}, 9, made({ model: "n", bakeHash: "b" }), "approved at revision 7, now at 9"],
    [{ bakeHash: "b" }, 7, made({ meshHash: "" }), "approved as it is now"],
    [{ bakeHash: "b" }, 7, null, "approved as it is now"],
  ])("%#: %j at %i", (more, now, is, words) => {
    expect(verdict(decision(more), now, is)).toBe(words);
    expect(stands(decision(more), now, is)).toBe(words.endsWith("as it is now"));
  });
});
