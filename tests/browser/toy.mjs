// SPDX-License-Identifier: MIT
// A small textured model, made here: two bodies and a plate, with maps of every kind, two sets of
// texture coordinates, a transform, clamped and mirrored maps, and variants of its materials.
import { crc32, deflateSync } from "node:zlib";

const crc = crc32 ?? crcByTable;
function crcByTable(bytes) {
  let sum = ~0;
  for (const byte of bytes) {
    sum ^= byte;
    for (let k = 0; k < 8; k++) sum = (sum >>> 1) ^ (sum & 1 ? 0xedb88320 : 0);
  }
  return ~sum >>> 0;
}

/** A PNG of n x n pixels, RGB of 8 bits; color: of u and v in [0, 1]. */
export function png(n, color) {
  const rows = Buffer.alloc(n * (3 * n + 1));
  for (let y = 0; y < n; y++)
    for (let x = 0; x < n; x++)
      color((x + 0.5) / n, (y + 0.5) / n).forEach((value, c) => {
        const level = Math.round(255 * Math.min(1, Math.max(0, value)));
        rows[y * (3 * n + 1) + 1 + 3 * x + c] = level;
      });
  const chunk = (type, data) => {
    const out = Buffer.alloc(12 + data.length);
    out.writeUInt32BE(data.length, 0);
    out.write(type, 4);
    data.copy(out, 8);
    out.writeUInt32BE(crc(out.subarray(4, 8 + data.length)), 8 + data.length);
    return out;
  };
  const head = Buffer.from([0, 0, 0, 0, 0, 0, 0, 0, 8, 2, 0, 0, 0]);
  head.writeUInt32BE(n, 0);
  head.writeUInt32BE(n, 4);
  return Buffer.concat([
    Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]),
    chunk("IHDR", head),
    chunk("IDAT", deflateSync(rows)),
    chunk("IEND", Buffer.alloc(0)),
  ]);
}

const wave = (x, turns) => 0.5 + 0.5 * Math.sin(2 * Math.PI * turns * x);
function ripples(u, v) {
  const x = 0.5 * Math.cos(2 * Math.PI * 5 * u);
  const y = 0.5 * Math.cos(2 * Math.PI * 4 * v);
  const l = Math.hypot(x, y, 1);
  return [x / l, y / l, 1 / l].map((c) => 0.5 + 0.5 * c);
}
const IMAGES = [
  png(64, (u, v) => [
    0.25 + 0.7 * wave(u, 3),
    0.35 + 0.5 * wave(v, 2),
    0.3 + 0.3 * wave(u + v, 1),
  ]),
  png(64, ripples),
  png(32, (u, v) => [0, 0.15 + 0.6 * wave(v, 2), 0]),
  png(32, (u) => [0.35 + 0.65 * wave(u, 2), 0, 0]),
  png(32, (u, v) => [wave(u, 2) ** 4 * wave(v, 3) ** 4, 0.1 * wave(v, 1), 0]),
];

function sphere(centre, radius, n) {
  const position = [];
  const normal = [];
  const uv = [[], []];
  const index = [];
  for (let i = 0; i <= n; i++)
    for (let k = 0; k <= n; k++) {
      const [a, b] = [(Math.PI * i) / n, (2 * Math.PI * k) / n];
      const d = [Math.sin(a) * Math.cos(b), Math.cos(a), -Math.sin(a) * Math.sin(b)];
      normal.push(...d);
      position.push(...d.map((x, c) => centre[c] + radius * x));
      uv[0].push(k / n, i / n);
      uv[1].push((2 * k) / n - 0.4, (1.7 * i) / n - 0.3);
    }
  for (let i = 0; i < n; i++)
    for (let k = 0; k < n; k++) {
      const at = i * (n + 1) + k;
      if (i > 0) index.push(at, at + n + 1, at + 1);
      if (i < n - 1) index.push(at + 1, at + n + 1, at + n + 2);
    }
  return { position, normal, uv, index };
}
function plate(y, half, n) {
  const out = { position: [], normal: [], uv: [[], []], index: [] };
  for (let i = 0; i <= n; i++)
    for (let k = 0; k <= n; k++) {
      out.position.push(half * ((2 * k) / n - 1), y, half * ((2 * i) / n - 1));
      out.normal.push(0, 1, 0);
      out.uv[0].push(k / n, i / n);
      out.uv[1].push(k / n, i / n);
      const at = i * (n + 1) + k;
      if (i < n && k < n)
        out.index.push(at, at + n + 1, at + 1, at + 1, at + n + 1, at + n + 2);
    }
  return out;
}

/** The GLB. Variants: "day" (as it is) and "night": the left body has another medium, roughness
 * and no map, the right body the left one's. */
export function toy() {
  const shapes = [
    sphere([-1.1, 0, 0], 1, 20),
    sphere([1, -0.2, 0], 0.8, 16),
    plate(-1.1, 2.4, 8),
  ];
  const chunks = [];
  const bufferViews = [];
  const accessors = [];
  let size = 0;
  const view = (bytes) => {
    const padded = Buffer.concat([bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4)]);
    bufferViews.push({ buffer: 0, byteOffset: size, byteLength: bytes.length });
    chunks.push(padded);
    size += padded.length;
    return bufferViews.length - 1;
  };
  const accessor = (values, type, width) => {
    const floats = type === "f";
    const array = floats ? Float32Array.from(values) : Uint16Array.from(values);
    const at = view(Buffer.from(array.buffer));
    const bounds = width === 3 && floats;
    const edge = (pick) => [0, 1, 2].map((c) => pick(...array.filter((_, i) => i % 3 === c)));
    accessors.push({
      bufferView: at,
      componentType: floats ? 5126 : 5123,
      count: values.length / width,
      type: { 1: "SCALAR", 2: "VEC2", 3: "VEC3" }[width],
      ...(bounds ? { min: edge(Math.min), max: edge(Math.max) } : {}),
    });
    return accessors.length - 1;
  };
  const scatter = (color) => ({
    KHR_materials_volume: {
      thicknessFactor: 1,
      attenuationColor: color,
      attenuationDistance: 0.2,
    },
    KHR_materials_transmission: { transmissionFactor: 1 },
  });
  const map = (index, more = {}) => ({ index, ...more });
  const moved = {
    KHR_texture_transform: { offset: [0.1, 0.2], rotation: 0.4, scale: [1.5, 0.8] },
  };
  const materials = [
    {
      name: "Left",
      pbrMetallicRoughness: {
        baseColorTexture: map(0, { extensions: moved }),
        metallicRoughnessTexture: map(2),
        metallicFactor: 0,
        roughnessFactor: 0.8,
      },
      normalTexture: map(1, { scale: 0.8 }),
      occlusionTexture: map(3, { texCoord: 1, strength: 0.7 }),
      emissiveTexture: map(4),
      emissiveFactor: [0.5, 0.5, 0.5],
      extensions: scatter([0.9, 0.6, 0.4]),
    },
    {
      name: "Right",
      pbrMetallicRoughness: {
        baseColorFactor: [0.9, 0.95, 1, 1],
        baseColorTexture: map(5, { texCoord: 1 }),
        metallicFactor: 0,
        roughnessFactor: 0.35,
      },
      extensions: scatter([0.5, 0.8, 0.6]),
    },
    {
      name: "Plate",
      pbrMetallicRoughness: {
        baseColorFactor: [0.7, 0.6, 0.5, 1],
        baseColorTexture: map(0),
        metallicFactor: 0,
      },
      occlusionTexture: map(3),
    },
    {
      name: "Night",
      pbrMetallicRoughness: {
        baseColorFactor: [0.3, 0.4, 0.9, 1],
        metallicFactor: 0,
        roughnessFactor: 0.2,
      },
      extensions: scatter([0.2, 0.3, 0.9]),
    },
  ];
  const mappings = [[{ material: 3, variants: [1] }], [{ material: 0, variants: [1] }], null];
  const meshes = shapes.map((shape, i) => ({
    primitives: [
      {
        attributes: {
          POSITION: accessor(shape.position, "f", 3),
          NORMAL: accessor(shape.normal, "f", 3),
          TEXCOORD_0: accessor(shape.uv[0], "f", 2),
          TEXCOORD_1: accessor(shape.uv[1], "f", 2),
        },
        indices: accessor(shape.index, "u", 1),
        material: i,
        ...(mappings[i]
          ? { extensions: { KHR_materials_variants: { mappings: mappings[i] } } }
          : {}),
      },
    ],
  }));
  const images = IMAGES.map((bytes) => ({ bufferView: view(bytes), mimeType: "image/png" }));
  const textures = [
    ...images.map((_, source) => ({ source, sampler: 0 })),
    { source: 0, sampler: 1 },
  ];
  const json = {
    asset: { version: "2.0" },
    extensionsUsed: [
      "KHR_materials_volume",
      "KHR_materials_transmission",
      "KHR_materials_variants",
      "KHR_texture_transform",
    ],
    extensions: { KHR_materials_variants: { variants: [{ name: "day" }, { name: "night" }] } },
    scene: 0,
    scenes: [{ nodes: [0, 1, 2] }],
    nodes: meshes.map((_, mesh) => ({ mesh, name: `${materials[mesh].name} node` })),
    meshes,
    materials,
    textures,
    images,
    samplers: [{}, { wrapS: 33648, wrapT: 33071 }],
    accessors,
    bufferViews,
    buffers: [{ byteLength: size }],
  };
  const text = Buffer.from(JSON.stringify(json));
  const head = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, 0x20)]);
  const out = Buffer.alloc(20);
  out.write("glTF", 0);
  out.writeUInt32LE(2, 4);
  out.writeUInt32LE(28 + head.length + size, 8);
  out.writeUInt32LE(head.length, 12);
  out.write("JSON", 16);
  const tail = Buffer.alloc(8);
  tail.writeUInt32LE(size, 0);
  tail.write("BIN\0", 4);
  return Buffer.concat([out, head, tail, ...chunks]);
}
