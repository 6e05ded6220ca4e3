// SPDX-License-Identifier: MIT
// The maps of a surface (PROTOCOL, INFO, LIST, GEOMETRY) as textures, uniforms and definitions of
// the surface's shader.
import {
  ClampToEdgeWrapping,
  DataTexture,
  LinearFilter,
  LinearMipmapLinearFilter,
  LinearMipmapNearestFilter,
  LinearSRGBColorSpace,
  MirroredRepeatWrapping,
  NearestFilter,
  NearestMipmapLinearFilter,
  NearestMipmapNearestFilter,
  RepeatWrapping,
  RGBAFormat,
  SRGBColorSpace,
  UnsignedByteType,
  Vector3,
  Vector4,
  type IUniform,
  type MinificationTextureFilter,
} from "three";
import { TextureKind, type Surface, type TextureMap } from "../gen/relight_pb";

/** An image and its mip chain: RGBA of 8 bits, level after level. */
export interface TextureData {
  texels: Uint8Array;
  width: number;
  height: number;
  kind: TextureKind;
}
/** The images that are here, by their index in GEOMETRY. */
export type Images = ReadonlyMap<number, TextureData>;

const MOST_ANISOTROPY = 16;
const WRAPS = [RepeatWrapping, ClampToEdgeWrapping, MirroredRepeatWrapping] as const;
const FILTER = { magNearest: 1, minNearest: 2, levelNearest: 4, noLevels: 8 } as const;
const has = (filter: number, bit: number) => (filter & bit) !== 0;

function minification(filter: number): MinificationTextureFilter {
  const nearest = has(filter, FILTER.minNearest);
  if (has(filter, FILTER.noLevels)) return nearest ? NearestFilter : LinearFilter;
  if (has(filter, FILTER.levelNearest))
    return nearest ? NearestMipmapNearestFilter : LinearMipmapNearestFilter;
  return nearest ? NearestMipmapLinearFilter : LinearMipmapLinearFilter;
}

interface Level {
  data: Uint8Array<ArrayBuffer>;
  width: number;
  height: number;
}
/** The levels of a mip chain; throws where the texels end too early. */
export function levelsOf({ texels, width, height }: TextureData): Level[] {
  const out: Level[] = [];
  let at = 0;
  for (let [w, h] = [width, height]; ; w = Math.max(1, w >> 1), h = Math.max(1, h >> 1)) {
    const data = texels.slice(at, at + 4 * w * h);
    if (data.length !== 4 * w * h) throw new Error("an image ends behind its payload");
    out.push({ data, width: w, height: h });
    at += data.length;
    if (w === 1 && h === 1) return out;
  }
}

/** Textures of a model's images; those of one image, wrap and filter are one texture. */
export class MapTextures {
  private readonly images: Images;
  private readonly anisotropy: number;
  private readonly made = new Map<string, DataTexture>();

  constructor(images: Images, anisotropy: number) {
    this.images = images;
    this.anisotropy = Math.min(anisotropy, MOST_ANISOTROPY);
  }

  /** null: the image is not here. */
  of(map: TextureMap): DataTexture | null {
    const image = this.images.get(map.image);
    if (!image) return null;
    const key = [map.image, map.wrapU, map.wrapV, map.filter].join();
    const old = this.made.get(key);
    if (old) return old;
    const levels = levelsOf(image);
    const texture = new DataTexture(
      levels[0]?.data,
      image.width,
      image.height,
      RGBAFormat,
      UnsignedByteType,
    );
    if (!has(map.filter, FILTER.noLevels)) texture.mipmaps = levels;
    texture.generateMipmaps = false;
    texture.wrapS = WRAPS[map.wrapU] ?? RepeatWrapping;
    texture.wrapT = WRAPS[map.wrapV] ?? RepeatWrapping;
    texture.minFilter = minification(map.filter);
    texture.magFilter = has(map.filter, FILTER.magNearest) ? NearestFilter : LinearFilter;
    texture.anisotropy = has(map.filter, FILTER.minNearest) ? 1 : this.anisotropy;
    texture.colorSpace =
      image.kind === TextureKind.TEXTURE_COLOR ? SRGBColorSpace : LinearSRGBColorSpace;
    texture.needsUpdate = true;
    this.made.set(key, texture);
    return texture;
  }

  dispose(): void {
    for (const texture of this.made.values()) texture.dispose();
    this.made.clear();
  }
}

/** The inputs of one surface's shader. */
export interface SurfaceLook {
  /** Sets of texture coordinates that its maps use, at most five. */
  uvSets: number[];
  defines: Record<string, number>;
  uniforms: Record<string, IUniform>;
}

const MAPS = ["base", "normal", "roughness", "occlusion", "emissive"] as const;
type MapName = (typeof MAPS)[number];
const mapOf = (surface: Surface | null, name: MapName): TextureMap | undefined =>
  ({
    base: surface?.baseMap,
    normal: surface?.normalMap,
    roughness: surface?.roughnessMap,
    occlusion: surface?.occlusionMap,
    emissive: surface?.emissiveMap,
  })[name];

/** Indices of the images that surfaces use. */
export function imagesOf(surfaces: readonly (Surface | null)[]): Set<number> {
  const maps = surfaces.flatMap((surface) => MAPS.map((name) => mapOf(surface, name)));
  return new Set(maps.filter((map) => map !== undefined).map((map) => map.image));
}

// The maps whose image and coordinates are here.
function usable(
  surface: Surface | null,
  textures: MapTextures,
  nUv: number,
): { name: MapName; map: TextureMap; texture: DataTexture }[] {
  return MAPS.flatMap((name) => {
    const map = mapOf(surface, name);
    const texture = map && map.uvSet < nUv ? textures.of(map) : null;
    return map && texture ? [{ name, map, texture }] : [];
  });
}

/** Base colours of translucent surfaces count with a map or vertex colours only: without either,
 * the medium alone gives their colour. Those of opaque ones are in their radiance. */
export function lookOf(
  surface: Surface | null,
  textures: MapTextures,
  mesh: { nUv: number; tinted: boolean; opaque: boolean },
): SurfaceLook {
  const maps = usable(surface, textures, mesh.nUv);
  const uvSets = [...new Set(maps.map(({ map }) => map.uvSet))].sort();
  const defines: Record<string, number> = {};
  const uniforms: Record<string, IUniform> = {};
  for (const { name, map, texture } of maps) {
    const [a = 1, b = 0, c = 0, d = 0, e = 1, f = 0] = map.transform;
    defines[`${name.toUpperCase()}_UV`] = uvSets.indexOf(map.uvSet);
    uniforms[`${name}Map`] = { value: texture };
    uniforms[`${name}Place`] = { value: [new Vector3(a, b, c), new Vector3(d, e, f)] };
    uniforms[`${name}Scale`] = { value: map.scale };
  }
  if (mesh.tinted) defines.TINTED = 1;
  const factor = surface?.baseColor.length === 4 ? surface.baseColor : [1, 1, 1, 1];
  const counts = !mesh.opaque && ("BASE_UV" in defines || mesh.tinted);
  const [r = 1, g = 1, b = 1, a = 1] = counts ? factor : [];
  const { x = 0, y = 0, z = 0 } = surface?.emissive ?? {};
  uniforms.baseColor = { value: new Vector4(r, g, b, a) };
  uniforms.emissive = { value: new Vector3(x, y, z) };
  uniforms.roughnessFactor = { value: surface?.roughness ?? 1 };
  return { uvSets, defines, uniforms };
}
