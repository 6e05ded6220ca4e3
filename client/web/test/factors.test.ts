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
  factors.multiply(renderer, light, colors, planes);
  expect(drawn).toEqual([
    { scale: 2 ** -20, first: half, layer: 0 },
    { scale: 2 ** -16, first: two, layer: 0 },
  ]);
  factors.dispose();
});
