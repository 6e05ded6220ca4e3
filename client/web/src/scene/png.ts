// SPDX-License-Identifier: MIT
// PNG files of RGBA as bytes. A canvas would multiply colours by alpha and back, and round.

const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
const HEADER = 0x49484452; // IHDR
const DATA = 0x49444154; // IDAT
const END = 0x49454e44; // IEND

interface Packed {
  width: number;
  height: number;
  data: Uint8Array<ArrayBuffer>[];
}

function unpack(file: Uint8Array<ArrayBuffer>): Packed {
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength);
  const out: Packed = { width: 0, height: 0, data: [] };
  if (SIGNATURE.some((byte, i) => file[i] !== byte)) throw new Error("an image is no PNG file");
  for (let at = 8; at + 12 <= file.length; ) {
    const size = view.getUint32(at);
    const type = view.getUint32(at + 4);
    const body = file.subarray(at + 8, at + 8 + size);
    if (type === HEADER && size === 13) {
      // 8 bits, RGBA, not interlaced
      if (body[8] !== 8 || body[9] !== 6 || body[12]) throw new Error("a PNG file is not RGBA");
      out.width = view.getUint32(at + 8);
      out.height = view.getUint32(at + 12);
    }
    if (type === DATA) out.data.push(body);
    if (type === END) return out;
    at += 12 + size;
  }
  throw new Error("a PNG file ends too early");
}

async function inflate(data: Uint8Array<ArrayBuffer>[]): Promise<Uint8Array> {
  const stream = new Blob(data).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function paeth(left: number, up: number, corner: number): number {
  const guess = left + up - corner;
  const [a, b, c] = [Math.abs(guess - left), Math.abs(guess - up), Math.abs(guess - corner)];
  return a <= b && a <= c ? left : b <= c ? up : corner;
}

function prediction(filter: number, left: number, up: number, corner: number): number {
  switch (filter) {
    case 0:
      return 0;
    case 1:
      return left;
    case 2:
      return up;
    case 3:
      return (left + up) >> 1;
    case 4:
      return paeth(left, up, corner);
    default:
      throw new Error("a PNG file has an unknown filter");
  }
}

/** Undoes the filters of rows of `n` bytes, each behind its filter's number. */
export function unfilter(rows: Uint8Array, n: number, height: number, out: Uint8Array): void {
  if (rows.length !== (n + 1) * height) throw new Error("a PNG file has another size");
  for (let y = 0; y < height; y++) {
    const from = y * (n + 1);
    const filter = rows[from] ?? 0;
    const to = y * n;
    for (let i = 0; i < n; i++) {
      const left = i < 4 ? 0 : (out[to + i - 4] ?? 0);
      const up = y ? (out[to + i - n] ?? 0) : 0;
      const corner = y && i >= 4 ? (out[to + i - n - 4] ?? 0) : 0;
      out[to + i] = (rows[from + 1 + i] ?? 0) + prediction(filter, left, up, corner);
    }
  }
}

/** Whether this browser can read them. */
export const readsPng = typeof DecompressionStream === "function";

/** The texels of files one after another, `sizes` bytes each. */
export async function texelsOf(
  files: Uint8Array,
  sizes: readonly number[],
): Promise<Uint8Array<ArrayBuffer>> {
  const levels: Packed[] = [];
  const own = new Uint8Array(files);
  for (let i = 0, at = 0; i < sizes.length; at += sizes[i] ?? 0, i++)
    levels.push(unpack(own.subarray(at, at + (sizes[i] ?? 0))));
  const bytes = ({ width, height }: Packed) => 4 * width * height;
  const out = new Uint8Array(levels.reduce((sum, level) => sum + bytes(level), 0));
  let at = 0;
  for (const level of levels) {
    const to = out.subarray(at, (at += bytes(level)));
    unfilter(await inflate(level.data), 4 * level.width, level.height, to);
  }
  return out;
}
