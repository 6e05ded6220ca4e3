# SPDX-License-Identifier: MIT
"""A ball with textures as GLB, and images as PNG, for tests."""
import json
import math
import struct
import zlib


def png(width, height, rows, lie=None):
    def chunk(kind, body):
        return struct.pack('>I', len(body)) + kind + body + struct.pack('>I', zlib.crc32(kind + body))
    data = b''.join(b'\0' + bytes(v for p in row for v in p) for row in rows)
    head = struct.pack('>IIBBBBB', *(lie or (width, height)), 8, 2, 0, 0, 0)
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', head) + chunk(b'IDAT', zlib.compress(data)) +
            chunk(b'IEND', b''))


def flat(rgb, side=4):
    return png(side, side, [[rgb] * side] * side)


def ball(rings=12, n=24):
    at, uv, tri = [], [], []
    for i in range(rings + 1):
        for j in range(n + 1):
            a, b = math.pi * i / rings, 2 * math.pi * j / n
            at.append((math.sin(a) * math.sin(b), math.cos(a), math.sin(a) * math.cos(b)))
            uv.append((j / n, i / rings))
    for i in range(rings):
        for j in range(n):
            a, b = i * (n + 1) + j, (i + 1) * (n + 1) + j
            tri += [(a, b, a + 1)] * (i > 0) + [(a + 1, b, b + 1)] * (i < rings - 1)
    return at, uv, tri


def glb(path, images, material, opaque=False, sampler=None):
    """A ball of radius 10 mm, and with `opaque` a second one beside it of material 1. sampler: glTF's, of all images."""
    at, uv, tri = ball()
    bin_, views = b'', []
    for part in (b''.join(struct.pack('<3f', *p) for p in at),
                 b''.join(struct.pack('<2f', *p) for p in uv),
                 b''.join(struct.pack('<3H', *t) for t in tri), *images):
        views.append({'buffer': 0, 'byteOffset': len(bin_), 'byteLength': len(part)})
        bin_ += part + b'\0' * (-len(part) % 4)
    primitive = {'attributes': {'POSITION': 0, 'NORMAL': 0, 'TEXCOORD_0': 1}, 'indices': 2}
    doc = {
        'asset': {'version': '2.0'}, 'scene': 0,
        'scenes': [{'nodes': [0, 1] if opaque else [0]}],
        'nodes': [{'mesh': 0, 'scale': [.01] * 3},
                  {'mesh': 1, 'scale': [.01] * 3, 'translation': [.03, 0, 0], 'name': 'stone'}],
        'meshes': [{'primitives': [dict(primitive, material=0)]},
                   {'primitives': [dict(primitive, material=1)]}],
        'materials': [material, dict(material, name='second')],
        'images': [{'bufferView': 3 + i, 'mimeType': 'image/png', 'name': 'picture%d' % i}
                   for i in range(len(images))],
        'samplers': [sampler or {}],
        'textures': [{'source': i, 'sampler': 0} for i in range(len(images))],
        'accessors': [
            {'bufferView': 0, 'componentType': 5126, 'count': len(at), 'type': 'VEC3',
             'min': [-1, -1, -1], 'max': [1, 1, 1]},
            {'bufferView': 1, 'componentType': 5126, 'count': len(uv), 'type': 'VEC2'},
            {'bufferView': 2, 'componentType': 5123, 'count': 3 * len(tri), 'type': 'SCALAR'}],
        'bufferViews': views, 'buffers': [{'byteLength': len(bin_)}]}
    text = json.dumps(doc).encode()
    text += b' ' * (-len(text) % 4)
    with open(path, 'wb') as f:
        f.write(struct.pack('<4sIIII', b'glTF', 2, 28 + len(text) + len(bin_), len(text),
                            0x4e4f534a) + text + struct.pack('<II', len(bin_), 0x4e4942) + bin_)
