#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
# The largest CIEDE2000 of two PNG files of 8 or 16 bits a channel: picture_difference.py A B BOUND.
# Fails above the bound. Where one file has 8 bits, the other is rounded to them.
import struct
import sys
import zlib
from math import atan2, cos, degrees, exp, hypot, radians, sin, sqrt


def read_png(path):
    """Width, height and rows of (r, g, b) in [0,255]; 16 bits have fractions."""
    data = open(path, 'rb').read()
    at, packed, head = 8, b'', None
    while at < len(data):
        n, kind = struct.unpack('>I4s', data[at:at + 8])
        body = data[at + 8:at + 8 + n]
        if kind == b'IHDR':
            head = struct.unpack('>IIBBBBB', body)
        elif kind == b'IDAT':
            packed += body
        at += n + 12
    width, height, bits, color = head[:4]
    assert bits in (8, 16) and color in (2, 6) and not head[6], head
    step = (3 if color == 2 else 4) * bits // 8
    raw, row, rows = zlib.decompress(packed), bytearray(width * step), []
    for y in range(height):
        filtered, line = raw[y * (width * step + 1)], bytearray()
        for i, x in enumerate(raw[y * (width * step + 1) + 1:(y + 1) * (width * step + 1)]):
            a = line[i - step] if i >= step else 0
            b, c = row[i], row[i - step] if i >= step else 0
            p = a + b - c
            paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            line.append((x + (0, a, b, (a + b) // 2, paeth)[filtered]) & 255)
        row = line
        if bits == 16:
            values = [x / 257 for x in struct.unpack(f'>{width * step // 2}H', line)]
            rows.append([tuple(values[k:k + 3]) for k in range(0, len(values), step // 2)])
        else:
            rows.append([tuple(line[k:k + 3]) for k in range(0, len(line), step)])
    return width, height, rows


def lab(rgb):
    lin = [x / 255 / 12.92 if x <= 10.31475 else ((x / 255 + .055) / 1.055) ** 2.4 for x in rgb]
    xyz = [.4123908 * lin[0] + .3575843 * lin[1] + .1804808 * lin[2],
           .212639 * lin[0] + .7151687 * lin[1] + .0721923 * lin[2],
           .0193308 * lin[0] + .1191948 * lin[1] + .9505322 * lin[2]]
    f = [t ** (1 / 3) if t > 216 / 24389 else (24389 / 27 * t + 16) / 116
         for t in (x / w for x, w in zip(xyz, (.950489, 1, 1.08884)))]
    return 116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])


def ciede2000(one, two):
    """Sharma, Wu and Dalal 2005."""
    mean = (hypot(*one[1:]) + hypot(*two[1:])) / 2
    stretch = 1.5 - .5 * sqrt(mean ** 7 / (mean ** 7 + 25 ** 7))
    a1, a2 = stretch * one[1], stretch * two[1]
    c1, c2 = hypot(a1, one[2]), hypot(a2, two[2])
    h1, h2 = degrees(atan2(one[2], a1)) % 360, degrees(atan2(two[2], a2)) % 360
    grey, dh, h = c1 * c2 == 0, h2 - h1, h1 + h2
    if grey:
        dh = 0
    elif abs(h1 - h2) > 180:
        dh -= 360 if dh > 180 else -360
        h = (h + 360 if h < 360 else h - 360) / 2
    else:
        h /= 2
    light, c = (one[0] + two[0]) / 2, (c1 + c2) / 2
    t = (1 - .17 * cos(radians(h - 30)) + .24 * cos(radians(2 * h)) +
         .32 * cos(radians(3 * h + 6)) - .2 * cos(radians(4 * h - 63)))
    x = (two[0] - one[0]) / (1 + .015 * (light - 50) ** 2 / sqrt(20 + (light - 50) ** 2))
    y = (c2 - c1) / (1 + .045 * c)
    z = 2 * sqrt(c1 * c2) * sin(radians(dh / 2)) / (1 + .015 * c * t)
    turn = -2 * sqrt(c ** 7 / (c ** 7 + 25 ** 7)) * sin(radians(60 * exp(-((h - 275) / 25) ** 2)))
    return sqrt(x * x + y * y + z * z + turn * y * z)


if __name__ == '__main__':
    # Pairs 1, 7 and 17 of their table.
    for pair in (((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
                 ((50, 0, 0), (50, -1, 2), 2.3669), ((50, 2.5, 0), (73, 25, -18), 27.1492)):
        assert abs(ciede2000(*pair[:2]) - pair[2]) < 5e-5, pair
    a, b = read_png(sys.argv[1]), read_png(sys.argv[2])
    if any(all(x == int(x) for row in one[2] for pixel in row for x in pixel) for one in (a, b)):
        a, b = [(w, h, [[tuple(int(x + .5) for x in pixel) for pixel in row] for row in rows]) for w, h, rows in (a, b)]
    assert a[:2] == b[:2], f'{a[:2]} and {b[:2]} pixels'
    differ = [pair for one, two in zip(a[2], b[2]) for pair in zip(one, two) if pair[0] != pair[1]]
    values = {(x, y): ciede2000(lab(x), lab(y)) for x, y in set(differ)}
    most = max(values.values(), default=0)
    print(f'dE2000 of {sys.argv[1]} and {sys.argv[2]}: at most {most:.3f}, bound {sys.argv[3]}; '
          f'{len(differ)} of {a[0] * a[1]} pixels differ')
    sys.exit(most > float(sys.argv[3]))
