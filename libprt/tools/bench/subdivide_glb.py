#!/usr/bin/python3
# SPDX-License-Identifier: MIT
"""A GLB of one primitive with every triangle divided into four: positions, normals and texture
coordinates of the middles are the means of their edges. Materials and images stay.

   subdivide_glb.py IN.glb OUT.glb        needs Debian's python3-numpy"""
import json
import struct
import sys

import numpy as np

TYPES = {5120: 'i1', 5121: 'u1', 5122: '<i2', 5123: '<u2', 5125: '<u4', 5126: '<f4'}
WIDTH = {'SCALAR': 1, 'VEC2': 2, 'VEC3': 3, 'VEC4': 4}


def chunks(data):
    size = struct.unpack('<I', data[12:16])[0]
    return json.loads(data[20:20 + size]), data[28 + size:]


def values(doc, bin_, index):
    a = doc['accessors'][index]
    view = doc['bufferViews'][a['bufferView']]
    kind, width = np.dtype(TYPES[a['componentType']]), WIDTH[a['type']]
    at = view.get('byteOffset', 0) + a.get('byteOffset', 0)
    stride = view.get('byteStride', kind.itemsize * width)
    return np.ndarray((a['count'], width), kind, bin_, at, (stride, kind.itemsize)).copy()


def divide(attributes, triangle):
    """The attributes with a row for each edge behind them, and the triangles."""
    edge = np.sort(triangle[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edge, index = np.unique(edge, axis=0, return_inverse=True)
    middle = index.reshape(-1, 3) + len(attributes['POSITION'])
    for name, rows in attributes.items():
        mean = rows[edge].mean(axis=1)
        if name == 'NORMAL':
            mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-20)
        attributes[name] = np.concatenate([rows, mean]).astype('<f4')
    (a, b, c), (ab, bc, ca) = triangle.T, middle.T
    return attributes, np.concatenate([np.stack(t, 1) for t in (
        (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]).astype('<u4')


def main(source, out):
    with open(source, 'rb') as f:
        doc, bin_ = chunks(f.read())
    primitive = doc['meshes'][0]['primitives'][0]
    keep = ('POSITION', 'NORMAL', 'TEXCOORD_0')
    attributes, triangle = divide(
        {k: values(doc, bin_, v) for k, v in primitive['attributes'].items() if k in keep},
        values(doc, bin_, primitive['indices']).reshape(-1, 3).astype(np.int64))

    def add(rows, kind, form):
        nonlocal bin_
        bin_ += b'\0' * (-len(bin_) % 4)
        doc['bufferViews'].append({'buffer': 0, 'byteOffset': len(bin_), 'byteLength': rows.nbytes})
        doc['accessors'].append({'bufferView': len(doc['bufferViews']) - 1, 'componentType': kind, 'type': form,
                                 'count': rows.size // WIDTH[form]})
        if form == 'VEC3':
            doc['accessors'][-1].update(min=rows.min(0).tolist(), max=rows.max(0).tolist())
        bin_ += rows.tobytes()
        return len(doc['accessors']) - 1

    primitive['attributes'] = {k: add(v, 5126, 'VEC2' if k == 'TEXCOORD_0' else 'VEC3') for k, v in attributes.items()}
    primitive['indices'] = add(triangle, 5125, 'SCALAR')
    bin_ += b'\0' * (-len(bin_) % 4)
    doc['buffers'][0]['byteLength'] = len(bin_)
    text = json.dumps(doc).encode()
    text += b' ' * (-len(text) % 4)
    with open(out, 'wb') as f:
        f.write(struct.pack('<4sIIII', b'glTF', 2, 28 + len(text) + len(bin_), len(text), 0x4e4f534a) + text +
                struct.pack('<II', len(bin_), 0x4e4942) + bin_)
    print('%s: %d vertices, %d triangles' % (out, len(attributes['POSITION']), len(triangle)))


main(*sys.argv[1:])
