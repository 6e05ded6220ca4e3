// SPDX-License-Identifier: MIT
// Textures of factors and coefficients, which the GPU multiplies into colours.
import { create } from "@bufbuild/protobuf";
import type { Mesh, RawShaderMaterial, Scene, WebGLRenderer } from "three";
import { expect, test } from "vitest";
import {
  CoefficientsSchema,
  ColorFormat,
  ColorsAnswerSchema,
  FactorsAnswerSchema,
  Term,
} from "../src/gen/relight_pb";
import { Factors, placesOf } from "../src/scene/factors";

// A renderer that notes the scale, the first coefficient and the layer of each sum.
function notingRenderer() {
  const drawn: { scale: unknown; first: number | undefined; layer: number }[] = [];
  let layer = 0;
  const renderer = {
    setClearColor: () => undefined,
    clear: () => undefined,
    setRenderTarget: (_: unknown, to = 0) => (layer = to),
    render: (scene: Scene) => {
      const { scale, rows } = ((scene.children[0] as Mesh).material as RawShaderMaterial)
        .uniforms;
      const texture = rows?.value as { image: { data: Uint16Array } };
      drawn.push({ scale: scale?.value, first: texture.image.data[0], layer });
    },
  };
  return { drawn, renderer: renderer as unknown as WebGLRenderer };
}

// PROTOCOL.md, COLORS: of coefficients with most_rank 2 a cluster has min(rank, 2) rows.
test("coarse coefficients have their own rows", () => {
  const clusters = Uint32Array.from([2, 5, 1, 1, 1, 3]); // vertices and rank of each
  const order = Uint32Array.from([3, 0, 2, 1]);
  const of = (mostRank: number) => Array.from(placesOf(clusters, order, 4, mostRank).places);
  // Of vertices 0 to 3: first texel, stride, rank, first row.
  expect(of(0)).toEqual([1, 16, 5, 0, 64, 16, 3, 6, 48, 16, 1, 5, 0, 16, 5, 0]);
  expect(of(2)).toEqual([1, 16, 2, 0, 64, 16, 2, 3, 48, 16, 1, 2, 0, 16, 2, 0]);
  expect(placesOf(clusters, order, 4, 2).texels).toBe(96);
});

// PROTOCOL.md, COLORS: one layer has a scale for each plane, and each plane its own halves.
test("each light's coefficients are multiplied by its own scale", () => {
  const [half, two] = [0x3800, 0x4000]; // 0.5 and 2 as halves
  const answer = create(FactorsAnswerSchema, {
    factors: 7n,
    nVertex: 1,
    tensors: [{ term: Term.MULTIPLE, nCluster: 1, orderOffset: 8n, uOffset: 16n, uBytes: 64n }],
  });
  const bytes = new Uint8Array(80);
  bytes.set(new Uint8Array(Uint32Array.from([1, 1]).buffer)); // one vertex, rank 1
  const factors = new Factors(answer, bytes);
  const light = create(CoefficientsSchema, {
    factors: 7n,
    layers: [{ tensor: 0, nRow: 1, nPhase: 1, scales: [1, 16] }],
  });
  const colors = create(ColorsAnswerSchema, {
    format: ColorFormat.COLOR_COEFFICIENTS,
    nPlane: 2,
    planeBytes: 8n,
  });
  const planes = new Uint8Array(Uint16Array.from([half, 0, 0, 0, two, 0, 0, 0]).buffer);
  const { drawn, renderer } = notingRenderer();
  expect(factors.multiply(renderer, light, colors, planes)).toMatchObject({
    layers: 1,
    exits: 0,
  });
  expect(drawn).toEqual([
    { scale: 2 ** -20, first: half, layer: 0 },
    { scale: 2 ** -16, first: two, layer: 0 },
  ]);
  factors.dispose();
});

test("the values of some vertices are found in the order of their list", () => {
  // Vertices 3 and 0 in a cluster of rank 5, 2 in one of rank 1, 1 in one of rank 3, as above.
  const bytes = new Uint8Array(48 + 4 * 96);
  bytes.set(new Uint8Array(Uint32Array.from([2, 5, 1, 1, 1, 3, 3, 0, 2, 1]).buffer));
  const factors = new Factors(
    create(FactorsAnswerSchema, {
      factors: 7n,
      nVertex: 4,
      tensors: [
        { term: Term.MULTIPLE, nCluster: 3, orderOffset: 24n, uOffset: 48n, uBytes: 384n },
      ],
    }),
    bytes,
  );
  const light = create(CoefficientsSchema, {
    factors: 7n,
    layers: [{ tensor: 0, nRow: 9, nPhase: 1, scales: [1] }],
  });
  const colors = create(ColorsAnswerSchema, {
    format: ColorFormat.COLOR_COEFFICIENTS,
    nPlane: 1,
    planeBytes: 56n,
  });
  let places: unknown;
  const renderer = {
    setClearColor: () => undefined,
    clear: () => undefined,
    setRenderTarget: () => undefined,
    render: (scene: Scene) => {
      const { uniforms } = (scene.children[0] as Mesh).material as RawShaderMaterial;
      const texture = uniforms.places?.value as { image: { data: Uint32Array } };
      places = Array.from(texture.image.data.subarray(0, 8));
    },
  } as unknown as WebGLRenderer;
  const some = Uint32Array.from([1, 3]);
  factors.multiply(renderer, light, colors, new Uint8Array(56), some);
  expect(places).toEqual([64, 16, 3, 6, 0, 16, 5, 0]);
  factors.multiply(renderer, light, colors, new Uint8Array(56));
  expect(places).toEqual([1, 16, 5, 0, 64, 16, 3, 6]); // of 0 and 1
  factors.dispose();
});
