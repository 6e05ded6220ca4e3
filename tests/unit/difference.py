#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""prt image --term difference: its numbers are those of the dipole's and the walks' own colours, and
a thin disc of milk, where the dipole sends back more than enters (METHODS §9), is red."""
import csv
import json
import math
import struct
import zlib

import programs
from programs import expect, prt

N, RINGS = 8, 4
WALKS = ('--scattering', 'walk', '--walks', '100')
BODY = ('disc.obj', '--size-mm', '10', '--material', 'skimmilk', '--env', 'constant', '--samples', '4000', '--seed', '3')


def disc(path, thickness):
    at = [(0, thickness, 0)]
    for i in range(1, RINGS):
        a = math.pi * i / RINGS
        for j in range(N):
            b = 2 * math.pi * j / N
            at.append((math.sin(a) * math.cos(b), thickness * math.cos(a), math.sin(a) * math.sin(b)))
    at.append((0, -thickness, 0))
    index = lambda i, j: 1 + (i - 1) * N + j % N
    tri = []
    for j in range(N):
        tri += [(0, index(1, j + 1), index(1, j)), (len(at) - 1, index(RINGS - 1, j), index(RINGS - 1, j + 1))]
        for i in range(1, RINGS - 1):
            tri += [(index(i, j), index(i, j + 1), index(i + 1, j)),
                    (index(i, j + 1), index(i + 1, j + 1), index(i + 1, j))]
    with open(path, 'w', encoding='utf-8') as f:
        f.writelines('v %g %g %g\n' % p for p in at)
        f.writelines('f %d %d %d\n' % tuple(k + 1 for k in t) for t in tri)


def colors(*options, body=BODY):
    prt('colors', *body, '--term', 'multiple', *options, '-o', 'c.csv')
    with open('c.csv', encoding='utf-8') as f:
        return [[float(row[c]) for c in 'rgb'] for row in csv.DictReader(f)]


def pixels(path):
    """Rows of (r, g, b) of an 8-bit PNG of three or four channels."""
    with open(path, 'rb') as f:
        data = f.read()
    at, body, head = 8, b'', None
    while at < len(data):
        n, kind = struct.unpack('>I4s', data[at:at + 8])
        part = data[at + 8:at + 8 + n]
        head = struct.unpack('>IIBBBBB', part) if kind == b'IHDR' else head
        body += part if kind == b'IDAT' else b''
        at += n + 12
    width, height, depth, kind = head[:4]
    expect(depth == 8 and kind in (2, 6), 'a PNG of %d bits, type %d' % (depth, kind))
    step = 3 if kind == 2 else 4
    raw, line, rows = zlib.decompress(body), bytearray(width * step), []
    for y in range(height):
        how, now = raw[y * (width * step + 1)], bytearray(raw[y * (width * step + 1) + 1:(y + 1) * (width * step + 1)])
        for x in range(width * step):
            a, b = now[x - step] if x >= step else 0, line[x]
            c = line[x - step] if x >= step else 0
            near = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            now[x] = (now[x] + (0, a, b, (a + b) // 2, near)[how]) & 255
        rows.append([tuple(now[x:x + 3]) for x in range(0, width * step, step)])
        line = now
    return rows


def numbers(told, dipole, walk):
    ratio = sorted(sum(d) / sum(w) - 1 for d, w in zip(dipole, walk) if sum(w) > 0)
    error = sum((a - b) ** 2 for d, w in zip(dipole, walk) for a, b in zip(d, w))
    rms = math.sqrt(error / sum(b * b for w in walk for b in w))
    fiftieth = len(ratio) // 50
    want = {'dipole_error': rms, 'dipole_darkest': ratio[fiftieth], 'dipole_brightest': ratio[-1 - fiftieth]}
    for name, value in want.items():
        print('%s: %.6f, of the colours %.6f' % (name, told[name], value))
        expect(abs(told[name] - value) < 1e-4 * (1 + abs(value)), '%s is not the colours\' own' % name)
    return ratio


def thin_milk_is_red():
    disc('disc.obj', 0.04)
    done = prt('image', *BODY, '--term', 'difference', '--engine', 'reference', *WALKS, '--size', '48x48',
               '--orbit', '20,50', '--json', '-o', 'd.png')
    told = json.loads(done.stdout)
    ratio = numbers(told, colors(), colors(*WALKS))
    expect(ratio[len(ratio) // 4] > 0, 'the dipole is not too bright there')
    drawn = [p for row in pixels('d.png') for p in row]
    red = sum(p[0] == 255 and p[2] < 200 for p in drawn)
    blue = sum(p[2] == 255 and p[0] < 200 for p in drawn)
    print('%d red and %d blue pixels of %d' % (red, blue, told['covered']))
    expect(red > 0.9 * told['covered'] > 20 and blue == 0, 'the disc is not red')


def opaque_parts_do_not_count():
    """They are the same by walks and by the dipole, and would thin the error of the others out."""
    disc('both.obj', 0.04)
    with open('both.obj', 'r+', encoding='utf-8') as f:
        n = sum(line.startswith('v ') for line in f)
        f.write('usemtl stone\n')
        f.writelines('v %g %g %g\n' % (x, -50, z) for x in range(15) for z in range(15))
        f.writelines('f %d %d %d\n' % (k, k + 1, k + 16) for k in range(n + 1, n + 201))
    body = ('both.obj', *BODY[1:], '--opaque', 'stone')
    told = json.loads(prt('image', *body, '--term', 'difference', '--engine', 'reference', *WALKS, '--size', '48x48',
                          '--json', '-o', 'd.png').stdout)
    numbers(told, colors(body=body)[:n], colors(*WALKS, body=body)[:n])


def a_free_medium_is_the_one_asked_for():
    """Of a joint bake by walks: the walks' colours are those of --material, as the dipole's are."""
    disc('disc.obj', 0.3)
    prt('bake', 'disc.obj', '--size-mm', '10', '--transport', 'joint', '--scattering', 'walk', '--walks', '16',
        '--samples', '500', '--cube', '16', '--no-single', '-q', '-o', 'joint.prt')
    body = ('joint.prt', '--material', 'skimmilk', '--env', 'constant', '--samples', '1000', '--seed', '3')
    told = json.loads(prt('image', *body, '--term', 'difference', '--size', '48x48', '--json', '-o', 'd.png').stdout)
    numbers(told, colors('--engine', 'reference', '--scattering', 'dipole', body=body), colors(body=body))


def of_one_light():
    """A polynomial bake's walks are of its own light, and so must the dipole's be."""
    disc('disc.obj', 0.3)
    prt('bake', 'disc.obj', '--size-mm', '10', '--transport', 'polynomial', '--scattering', 'walk', '--walks', '16',
        '--samples', '500', '--cube', '16', '--no-single', '--env', 'constant:1,1,2', '-q', '-o', 'one.prt')
    said = ''
    for light, status in (('constant:1,1,2', 0), ('constant:3,3,3', 2)):
        said = prt('image', 'one.prt', '--env', light, '--term', 'difference', '--size', '48x48', '--samples', '1000',
                   '-o', 'd.png', status=status).said
    expect('was baked under constant:1,1,2' in said, said)


programs.main(thin_milk_is_red, opaque_parts_do_not_count, a_free_medium_is_the_one_asked_for, of_one_light)
