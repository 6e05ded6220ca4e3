// SPDX-License-Identifier: MIT
import { deflateSync } from "node:zlib";
import { describe, expect, test } from "vitest";
import { texelsOf, unfilter } from "../src/scene/png";

function chunk(type: string, body: Uint8Array): Buffer {
  const out = Buffer.alloc(12 + body.length); // the sum at the end is not looked at
  out.writeUInt32BE(body.length);
  out.write(type, 4, "latin1");
  out.set(body, 8);
  return out;
}

// A file of rows that have their filters' numbers in front.
function file(width: number, height: number, rows: Uint8Array, colour = 6): Buffer {
  const header = Buffer.alloc(13);
  header.writeUInt32BE(width);
  header.writeUInt32BE(height, 4);
  header.set([8, colour, 0, 0, 0], 8);
  const data = deflateSync(rows);
  return Buffer.concat([
    Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]),
    chunk("IHDR", header),
    chunk("IDAT", data.subarray(0, 9)),
    chunk("IDAT", data.subarray(9)),
    chunk("IEND", Buffer.alloc(0)),
  ]);
}
const bytes = (...files: Buffer[]) => new Uint8Array(Buffer.concat(files));

describe("PNG files as texels", () => {
  test("each filter is undone", () => {
    // Two rows of two texels; the second row is the same for every filter.
    const above = [10, 20, 30, 40, 50, 60, 70, 80];
    const second: Record<number, number[]> = {
      0: [11, 22, 33, 44, 55, 66, 77, 88],
      1: [11, 22, 33, 44, 44, 44, 44, 44],
      2: [1, 2, 3, 4, 5, 6, 7, 8],
      3: [6, 12, 18, 24, 25, 25, 26, 26], // less half of left and up, rounded down
      4: [1, 2, 3, 4, 5, 6, 7, 8], // up is nearest
    };
    for (const [filter, row] of Object.entries(second)) {
      const out = new Uint8Array(16);
      unfilter(new Uint8Array([0, ...above, Number(filter), ...row]), 8, 2, out);
      expect([...out.subarray(8)], `filter ${filter}`).toEqual([
        11, 22, 33, 44, 55, 66, 77, 88,
      ]);
    }
    expect(() => unfilter(new Uint8Array([5, 1, 2, 3, 4]), 4, 1, new Uint8Array(4))).toThrow(
      "unknown filter",
    );
  });

  test("levels follow each other, with colours where alpha is 0", async () => {
    const large = file(2, 1, new Uint8Array([0, 200, 100, 50, 0, 1, 2, 3, 4]));
    const small = file(1, 1, new Uint8Array([0, 9, 8, 7, 0]));
    const texels = await texelsOf(bytes(large, small), [large.length, small.length]);
    expect([...texels]).toEqual([200, 100, 50, 0, 1, 2, 3, 4, 9, 8, 7, 0]);
  });

  test("what is no such file is refused", async () => {
    const good = file(1, 1, new Uint8Array([0, 1, 2, 3, 4]));
    await expect(texelsOf(bytes(good), [good.length - 12])).rejects.toThrow("ends too early");
    await expect(texelsOf(bytes(good.subarray(1)), [good.length - 1])).rejects.toThrow(
      "no PNG",
    );
    const grey = file(1, 1, new Uint8Array([0, 1]), 0);
    await expect(texelsOf(bytes(grey), [grey.length])).rejects.toThrow("not RGBA");
    const short = file(1, 2, new Uint8Array([0, 1, 2, 3, 4]));
    await expect(texelsOf(bytes(short), [short.length])).rejects.toThrow("another size");
  });
});
