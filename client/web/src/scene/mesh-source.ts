// SPDX-License-Identifier: MIT
// A model's mesh and the images of its maps, from GEOMETRY.
import {
  GeometryAnswerSchema,
  GeometryRequestSchema,
  type TextureImage,
} from "../gen/relight_pb";
import type { Client } from "../protocol/client";
import { Type } from "../protocol/frame";
import { meshOf, type Mesh } from "./geometry";
import { readsPng, texelsOf } from "./png";
import { imagesOf, type TextureData } from "./surface-maps";

export interface MeshSource {
  mesh: Mesh;
  /** Those that its maps use, by their index. */
  images: Map<number, TextureImage>;
}

export async function fetchMesh(
  client: Client,
  model: string,
  variant: string,
  textures = true,
): Promise<MeshSource> {
  const { message, payload } = await client.request(
    Type.Geometry,
    GeometryRequestSchema,
    { model, variant, ownUnits: true, textures },
    GeometryAnswerSchema,
  );
  const mesh = meshOf(message, payload);
  const images = new Map<number, TextureImage>();
  for (const index of imagesOf(mesh.parts.map(({ surface }) => surface))) {
    const image = message.images[index];
    if (image) images.set(index, image);
  }
  return { mesh, images };
}

/** The texels of images, one after another: on a slow link the light goes on between them. */
export async function fetchImages(
  client: Client,
  model: string,
  images: MeshSource["images"],
): Promise<Map<number, TextureData>> {
  const out = new Map<number, TextureData>();
  const png = readsPng && client.has("texture-png");
  for (const [index, { hash, width, height, kind }] of images) {
    const { message, payload } = await client.request(
      Type.Geometry,
      GeometryRequestSchema,
      { model, image: hash, png },
      GeometryAnswerSchema,
    );
    const sizes = message.images[0]?.pngBytes ?? [];
    const texels = sizes.length ? await texelsOf(payload, sizes) : payload;
    out.set(index, { texels, width, height, kind });
  }
  return out;
}
