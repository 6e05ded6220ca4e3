# SPDX-License-Identifier: MIT
"""A candle as a .gltf with three materials: wax (a ball), holder (two nodes, a slab and a ball) and
an opaque wick inside the wax."""
import base64
import json
import math
import struct

WAX = {'name': 'wax', 'pbrMetallicRoughness': {'baseColorFactor': [.8, .7, .5, 1]}, 'extensions': {'KHR_materials_volume': {'attenuationDistance': 0.003,
                       'attenuationColor': [.9, .6, .3]},
                                     'KHR_materials_ior': {'ior': 1.3}}}
HOLDER = {'name': 'holder', 'extensions': {'KHR_materials_transmission': {'transmissionFactor': 1}}}
WICK = {'name': 'wick', 'pbrMetallicRoughness': {'baseColorFactor': [.1, .1, .1, 1]}}


def ball(centre, radius, n):
    position, triangle = [], []
    for i in range(n + 1):
        for k in range(2 * n):
            t, p = math.pi * i / n, math.pi * k / n
            s = math.sin(t) if 0 < i < n else 0
            d = (s * math.cos(p), math.cos(t), -s * math.sin(p))
            position.append([centre[c] + radius[c] * d[c] for c in range(3)])
    for i in range(n):
        for k in range(2 * n):
            a, b = i * 2 * n + k, i * 2 * n + (k + 1) % (2 * n)
            triangle += [[a, a + 2 * n, b], [b, a + 2 * n, b + 2 * n]]
    return position, triangle


# Two bodies in one node ("pair") have primitives of both translucent materials.
BODIES = [('candle', [(0, ball((0, 0, 0), (8, 8, 8), 9))]),
          ('pair', [(0, ball((30, 0, 0), (5, 5, 5), 7)), (1, ball((30, -11, 0), (5, 4, 5), 7))]),
          ('foot', [(1, ball((0, -14, 0), (7, 4, 7), 8))]),
          ('thread', [(2, ball((0, 2, 0), (1, 4, 1), 5))])]


def write(path, materials=(WAX, HOLDER, WICK), bodies=BODIES, unit=0.001):
    data, views, accessors, meshes, nodes = b'', [], [], [], []
    for name, parts in bodies:
        primitives = []
        for material, (position, triangle) in parts:
            for kind, rows in ((5126, position), (5125, triangle)):
                flat = [x * unit if kind == 5126 else x for row in rows for x in row]
                piece = struct.pack('<%d%s' % (len(flat), 'f' if kind == 5126 else 'I'), *flat)
                views.append({'buffer': 0, 'byteOffset': len(data), 'byteLength': len(piece)})
                accessor = {'bufferView': len(views) - 1, 'componentType': kind,
                            'count': len(rows) if kind == 5126 else len(flat),
                            'type': 'VEC3' if kind == 5126 else 'SCALAR'}
                if kind == 5126:
                    accessor['min'] = [min(flat[c::3]) for c in range(3)]
                    accessor['max'] = [max(flat[c::3]) for c in range(3)]
                accessors.append(accessor)
                data += piece
            primitives.append({'attributes': {'POSITION': len(accessors) - 2},
                               'indices': len(accessors) - 1, 'material': material})
        meshes.append({'primitives': primitives})
        nodes.append({'mesh': len(meshes) - 1, 'name': name})
    with open(path, 'w', encoding='utf-8') as f:
        json.dump({'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': list(range(len(nodes)))}],
                   'nodes': nodes, 'meshes': meshes, 'materials': list(materials), 'accessors': accessors,
                   'bufferViews': views,
                   'buffers': [{'byteLength': len(data), 'uri': 'data:application/octet-stream;base64,' +
                                base64.b64encode(data).decode()}]}, f)


def vertices(node, material, bodies=BODIES):
    """Vertices of a node's primitives of one material, as a range."""
    at = 0
    for name, parts in bodies:
        for own, (position, _) in parts:
            if name == node and own == material:
                return range(at, at + len(position))
            at += len(position)
    raise KeyError(node)
