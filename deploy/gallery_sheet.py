#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Puts PNG files of one size and of 8-bit RGB side by side.

  gallery_sheet.py COLUMNS IN.png… OUT.png
"""
import struct
import sys
import zlib


def read(path):
    """Width, height and rows of bytes of an 8-bit RGB file."""
    data = open(path, "rb").read()
    at, packed, width, height = 8, b"", 0, 0
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + size]
        if kind == b"IHDR":
            width, height, depth, color = struct.unpack(">IIBB", body[:10])
            if (depth, color) != (8, 2):
                sys.exit(f"{path}: not 8-bit RGB")
        packed += body if kind == b"IDAT" else b""
        at += 12 + size
    raw, rows, stride = zlib.decompress(packed), [], 3 * width
    above = bytearray(stride)
    for y in range(height):
        kind, line = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for i in range(stride if kind else 0):
            a, b = line[i - 3] if i >= 3 else 0, above[i]
            c = above[i - 3] if i >= 3 else 0
            nearest = min((a, b, c), key=lambda x: abs(a + b - c - x))  # PNG's Paeth predictor
            line[i] = (line[i] + (0, a, b, (a + b) // 2, nearest)[kind]) & 255
        rows.append(bytes(line))
        above = line
    return width, height, rows


def write(path, width, height, rows):
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    packed = zlib.compress(b"".join(b"\0" + row for row in rows))
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)) +
                   chunk(b"IDAT", packed) + chunk(b"IEND", b""))


def main():
    if len(sys.argv) < 4 or not sys.argv[1].isdigit() or sys.argv[1] == "0":
        sys.exit(__doc__)
    columns, images = int(sys.argv[1]), [read(path) for path in sys.argv[2:-1]]
    width, height, _ = images[0]
    if any(image[:2] != (width, height) for image in images):
        sys.exit("the pictures differ in size")
    rows = []
    for first in range(0, len(images), columns):
        row = images[first:first + columns]
        rows += [b"".join(image[2][y] for image in row) + bytes(3 * width * (columns - len(row)))
                 for y in range(height)]
    write(sys.argv[-1], columns * width, len(rows), rows)


if __name__ == "__main__":
    main()
