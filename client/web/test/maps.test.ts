// SPDX-License-Identifier: MIT
import { create } from "@bufbuild/protobuf";
import { LinearMipmapLinearFilter, MirroredRepeatWrapping, SRGBColorSpace } from "three";
import { expect, test } from "vitest";
import {
  GeometryAnswerSchema,
  SurfaceSchema,
  TextureKind,
  TextureMapSchema,
} from "../src/gen/relight_pb";
import { cornersOf, meshOf, rowsAt } from "../src/scene/geometry";
import { imagesOf, levelsOf, lookOf, MapTextures } from "../src/scene/surface-maps";

const image = (width: number, height: number, n: number) => ({
  texels: new Uint8Array(n),
  width,
  height,
  kind: TextureKind.TEXTURE_COLOR,
});
const map = (index: number, uvSet: number) =>
  create(TextureMapSchema, { image: index, uvSet, wrapU: 2, transform: [1, 0, 0.5, 0, 1, 0] });

test("a mip chain ends at one texel; a short payload is refused", () => {
  const levels = levelsOf(image(5, 2, 4 * (10 + 2 + 1)));
  expect(levels.map(({ width, height }) => [width, height])).toEqual([
    [5, 2],
    [2, 1],
    [1, 1],
  ]);
  expect(() => levelsOf(image(5, 2, 4 * 12))).toThrow(/ends/);
});

test("maps without their image or coordinates are left out", () => {
  const surface = create(SurfaceSchema, {
    baseColor: [0.5, 0.5, 0.5, 1],
    baseMap: map(0, 1),
    normalMap: map(1, 0),
    roughnessMap: map(0, 7),
  });
  expect(imagesOf([surface, null])).toEqual(new Set([0, 1]));
  const textures = new MapTextures(new Map([[0, image(1, 1, 4)]]), 16);
  const look = lookOf(surface, textures, { nUv: 2, tinted: false, opaque: false });
  expect(look.uvSets).toEqual([1]);
  expect(look.defines).toEqual({ BASE_UV: 0 });
  expect(look.uniforms.baseColor?.value).toMatchObject({ x: 0.5, w: 1 });
  const texture = textures.of(map(0, 1));
  expect(texture?.wrapS).toBe(MirroredRepeatWrapping);
  expect(texture?.minFilter).toBe(LinearMipmapLinearFilter);
  expect(texture?.colorSpace).toBe(SRGBColorSpace);
  expect(textures.of(map(0, 1))).toBe(texture);
  // The factor is in the radiance of opaque surfaces.
  const opaque = lookOf(surface, textures, { nUv: 2, tinted: false, opaque: true });
  expect(opaque.uniforms.baseColor?.value).toMatchObject({ x: 1 });
});

test("vertices at seams are several, each with its coordinates", () => {
  const triangles = Uint32Array.from([0, 1, 2, 2, 1, 3]);
  const cornerUv = Float32Array.from([0, 0, 1, 0, 0, 1, 0, 1, 0.25, 0, 1, 1]);
  const corners = cornersOf({ triangles, cornerUv });
  expect(Array.from(corners?.triangles ?? [])).toEqual([0, 1, 2, 2, 3, 4]);
  expect(Array.from(corners?.source ?? [])).toEqual([0, 1, 2, 1, 3]);
  expect(Array.from(corners?.uv ?? []).slice(6, 8)).toEqual([0.25, 0]);
  const rows = rowsAt(
    Float32Array.from([0, 10, 20, 30]),
    1,
    corners?.source ?? new Uint32Array(),
  );
  expect(Array.from(rows)).toEqual([0, 10, 20, 10, 30]);
  expect(cornersOf({ triangles, cornerUv: null })).toBeNull();
});

// PROTOCOL.md, GEOMETRY: [n_uv][n_vertex][2] floats.
test("each set of texture coordinates is read where it lies", () => {
  const nVertex = 3;
  const uvOffset = 2 * 12 * nVertex;
  const sets = [0, 1, 2].map((set) =>
    Array.from({ length: 2 * nVertex }, (_, i) => 100 * set + i),
  );
  const numbers = [...new Array<number>(6 * nVertex).fill(0), ...sets.flat()];
  const payload = new Uint8Array(Float32Array.from(numbers).buffer);
  const answer = create(GeometryAnswerSchema, {
    nVertex,
    nUv: 3,
    normalsOffset: BigInt(12 * nVertex),
    uvOffset: BigInt(uvOffset),
  });
  expect(meshOf(answer, payload).uv.map((set) => Array.from(set))).toEqual(sets);
});
