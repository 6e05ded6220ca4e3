# SPDX-License-Identifier: MIT
"""Small animated glTF models: a bar of two bones, a ball that grows, a mesh on turning nodes."""
import base64
import json
import math
import struct

import candle

FLOAT, BYTE, SHORT, INT = 5126, 5121, 5123, 5125
LETTER = {FLOAT: 'f', BYTE: 'B', SHORT: 'H', INT: 'I'}
WIDTH = {'SCALAR': 1, 'VEC3': 3, 'VEC4': 4, 'MAT4': 16}


class Model:
    """A document that grows; buffers are data URIs, one a view."""

    def __init__(self):
        self.data = {'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0]}], 'nodes': [], 'meshes': [],
                     'accessors': [], 'bufferViews': [], 'buffers': []}
        self.position, self.normal, self.upper = [], [], []

    def accessor(self, kind, component, values, **more):
        flat = [x for v in values for x in (v if isinstance(v, (tuple, list)) else (v,))]
        index = len(self.data['accessors'])
        self.data['buffers'].append({})
        self.data['bufferViews'].append({'buffer': index})
        self.data['accessors'].append({'bufferView': index, 'componentType': component, 'type': kind,
                                       'count': len(flat) // WIDTH[kind], **more})
        replace(self.data, index, flat)
        return index

    def mesh(self, position, triangle, normal=None, **attributes):
        self.position, self.normal = position, normal or []
        low = [min(p[c] for p in position) for c in range(3)]
        high = [max(p[c] for p in position) for c in range(3)]
        primitive = {'attributes': {'POSITION': self.accessor('VEC3', FLOAT, position, min=low, max=high),
                                    **attributes},
                     'indices': self.accessor('SCALAR', INT, triangle)}
        if normal:
            primitive['attributes']['NORMAL'] = self.accessor('VEC3', FLOAT, normal)
        self.data['meshes'].append({'primitives': [primitive]})
        return primitive

    def animate(self, name, node, path, times, values, kind, mode='LINEAR'):
        self.data.setdefault('animations', []).append({
            'name': name,
            'samplers': [{'input': self.accessor('SCALAR', FLOAT, times, min=[times[0]], max=[times[-1]]),
                          'output': self.accessor(kind, FLOAT, values), 'interpolation': mode}],
            'channels': [{'sampler': 0, 'target': {'node': node, 'path': path}}]})

    def document(self):
        return self.data

    def write(self, path):
        with open(path, 'w', encoding='utf-8') as f:
            json.dump(self.data, f)


def replace(data, index, flat):
    """Other numbers for an accessor; fewer are repeated."""
    a = data['accessors'][index]
    n = a['count'] * WIDTH[a['type']]
    flat = (list(flat) * (n // len(flat) + 1))[:n]
    piece = struct.pack('<%d%s' % (n, LETTER[a['componentType']]), *flat)
    data['bufferViews'][a['bufferView']]['byteLength'] = len(piece)
    data['buffers'][a['bufferView']] = {'byteLength': len(piece), 'uri': 'data:application/octet-stream;base64,' +
                                        base64.b64encode(piece).decode()}


def quaternion(degrees):
    """About +z."""
    return (0, 0, math.sin(math.radians(degrees) / 2), math.cos(math.radians(degrees) / 2))


def tube(rings, sides):
    """A closed tube of radius 2 from y = 0 to 20."""
    position, normal, triangle = [(0, 0, 0)], [(0, -1, 0)], []
    for i in range(rings + 1):
        for k in range(sides):
            a = 2 * math.pi * k / sides
            position.append((2 * math.cos(a), 20 * i / rings, 2 * math.sin(a)))
            normal.append((math.cos(a), 0, math.sin(a)))
    position.append((0, 20, 0))
    normal.append((0, 1, 0))
    for k in range(sides):
        j = (k + 1) % sides
        triangle += [[0, 1 + k, 1 + j], [len(position) - 1, 1 + rings * sides + j, 1 + rings * sides + k]]
        for i in range(rings):
            a, b = 1 + i * sides + k, 1 + i * sides + j
            triangle += [[a, a + sides, b], [b, a + sides, b + sides]]
    return position, normal, triangle


def slide():
    """A ball whose x is t^3 and whose y falls by t, as a spline with tangents between two keys."""
    model = Model()
    position, triangle = candle.ball((0, 0, 0), (1, 1, 1), 5)
    model.mesh(position, triangle)
    model.data['nodes'] = [{'mesh': 0}]
    values = []
    for t in (1.0, 3.0):
        tangent = (3 * t * t, -1, 0)
        values += [tangent, (t ** 3, -t, 0), tangent]
    model.animate('slide', 0, 'translation', [1.0, 3.0], values, 'VEC3', 'CUBICSPLINE')
    return model


def bar(bits=8, mode='LINEAR', weight=1, node_translation=(0, 0, 0), negative=False):
    """Two bones: the lower one rests, the upper one, whose joint is at y = 10, turns by 90 degrees. negative: its
    last quaternion has the other sign."""
    model = Model()
    position, normal, triangle = tube(8, 8)
    upper = [min(max((p[1] - 7.5) / 5, 0), 1) for p in position]
    joints = model.accessor('VEC4', BYTE if bits == 8 else SHORT, [(0, 1, 0, 0)] * len(position))
    weights = model.accessor('VEC4', FLOAT, [(weight * (1 - u), weight * u, 0, 0) for u in upper])
    model.mesh(position, triangle, normal, JOINTS_0=joints, WEIGHTS_0=weights)
    model.upper = upper
    inverse = model.accessor('MAT4', FLOAT, [(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1),
                                             (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, -10, 0, 1)])
    model.data['nodes'] = [{'name': 'lower', 'children': [1]}, {'name': 'upper', 'translation': [0, 10, 0]},
                           {'name': 'bar', 'mesh': 0, 'skin': 0, 'translation': list(node_translation)}]
    model.data['scenes'][0]['nodes'] = [0, 2]
    model.data['skins'] = [{'joints': [0, 1], 'inverseBindMatrices': inverse}]
    a, b, flat = quaternion(0), quaternion(90), (0, 0, 0, 0)
    if negative:
        b = tuple(-x for x in b)
    values = [flat, a, flat, flat, b, flat] if mode == 'CUBICSPLINE' else [a, b]
    model.animate('bend', 1, 'rotation', [0.0, 1.0], values, 'VEC4', mode)
    return model


def ball_that_grows():
    """A morph target that doubles a ball, its weight animated from 0 to 1."""
    model = Model()
    position, triangle = candle.ball((0, 0, 0), (5, 5, 5), 7)
    primitive = model.mesh(position, triangle)
    primitive['targets'] = [{'POSITION': model.accessor('VEC3', FLOAT, position)}]
    model.data['meshes'][0]['weights'] = [0]
    model.data['nodes'] = [{'name': 'ball', 'mesh': 0}]
    model.animate('grow', 0, 'weights', [0.0, 1.0], [0.0, 1.0], 'SCALAR')
    return model


def carousel():
    """Three nested nodes, each 2 from the one before and turned by 30 degrees in a second."""
    model = Model()
    position, triangle = candle.ball((0, 0, 0), (1, 1, 1), 5)
    model.mesh(position, triangle)
    model.data['nodes'] = [{'children': [1], 'translation': [2, 0, 0]}, {'children': [2], 'translation': [2, 0, 0]},
                           {'mesh': 0, 'translation': [2, 0, 0]}]
    for node in range(3):
        model.animate('turn', node, 'rotation', [0.0, 1.0], [quaternion(0), quaternion(30)], 'VEC4')
    first, *others = model.data['animations']
    for other in others:
        first['samplers'] += other['samplers']
        first['channels'].append({**other['channels'][0], 'sampler': len(first['samplers']) - 1})
    model.data['animations'] = [first]
    return model


def plain():
    model = Model()
    position, triangle = candle.ball((0, 0, 0), (1, 1, 1), 5)
    model.mesh(position, triangle)
    model.data['nodes'] = [{'mesh': 0}]
    return model


def bytes_of(buffer):
    """Of a data URI."""
    return base64.b64decode(buffer['uri'].split(',')[1])
