#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Animations of glTF files against closed forms: a bar of two bones, a morph target, nested nodes,
the three interpolations; damaged files.

   tests/unit/animation.py PATH/TO/prt"""
import copy
import json
import math
import os
import struct
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import animated  # noqa: E402
from programs import expect, main, prt  # noqa: E402


def vertices(path, *args):
    """Positions and normals of the posed model, from a .ply of its irradiance."""
    prt('colors', path, '--env', 'constant', '--term', 'irradiance', '--cube', '16', '--samples', '100',
        '--material', 'marble', '--mm-per-unit', '1', *args, '-o', 'out.glb', '--quiet')
    with open('out.glb', 'rb') as f:
        data = f.read()
    n = struct.unpack('<I', data[12:16])[0]
    head, body = json.loads(data[20:20 + n]), data[28 + n:]
    out = []
    for name in ('POSITION', 'NORMAL'):
        values = []
        for primitive in (p for mesh in head['meshes'] for p in mesh['primitives']):
            which = primitive['attributes'].get(name)
            if which is None:
                continue
            a = head['accessors'][which]
            at = head['bufferViews'][a['bufferView']].get('byteOffset', 0) + a.get('byteOffset', 0)
            values += [struct.unpack('<3f', body[at + 12 * i:at + 12 * i + 12]) for i in range(a['count'])]
        if values:
            out.append(values)
    return out


def near(got, want, what, most=2e-5):
    worst = max(abs(x - y) for a, b in zip(got, want) for x, y in zip(a, b))
    expect(len(got) == len(want) and worst < most, '%s: off by %g' % (what, worst))


def turn(p, centre, degrees):
    """About +z through the centre."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    x, y = p[0] - centre[0], p[1] - centre[1]
    return (centre[0] + c * x - s * y, centre[1] + s * x + c * y, p[2])


def bar():
    """The upper bone turns by 90 degrees about its joint in the first second."""
    for bits in (8, 16):
        for mode in ('LINEAR', 'CUBICSPLINE', 'STEP'):
            model = animated.bar(bits=bits, mode=mode)
            model.write('bar.gltf')
            rest = model.position
            for time, angle in ((0, 0), (0.25, 22.5), (0.5, 45), (1, 90), (7, 90)):
                if mode == 'STEP':
                    angle = 0 if time < 1 else 90
                if mode == 'CUBICSPLINE':  # flat tangents: 3u^2 - 2u^3 between the quaternions
                    u = min(time, 1)
                    w = 3 * u * u - 2 * u ** 3
                    a, b = (0, 1), (math.sin(math.pi / 4), math.cos(math.pi / 4))
                    angle = 2 * math.degrees(math.atan2(w * b[0], (1 - w) * a[1] + w * b[1]))
                want = []
                for p, upper in zip(rest, model.upper):
                    bent = turn(p, (0, 10, 0), angle)
                    # linear blend skinning: the mean of the two places by weight
                    want.append([(1 - upper) * x + upper * y for x, y in zip(p, bent)])
                got = vertices('bar.gltf', '--animation', 'bend', '--time', str(time))
                near(got[0], want, 'bar %d bits %s at %g s' % (bits, mode, time))
    # weights that sum to 2 are normalised; the file's own node transform of the mesh is ignored
    model = animated.bar(bits=8, mode='LINEAR', weight=2, node_translation=(5, 5, 5))
    model.write('bar.gltf')
    got = vertices('bar.gltf', '--animation', 'be', '--time', '1')
    near(got[0], [[(1 - u) * x + u * y for x, y in zip(p, turn(p, (0, 10, 0), 90))]
                  for p, u in zip(model.position, model.upper)], 'weights of sum 2')
    if len(got) > 1:
        whole = [i for i, u in enumerate(model.upper) if u == 1]
        near([got[1][i] for i in whole], [turn(model.normal[i], (0, 0, 0), 90) for i in whole], 'normals', 1e-3)


def long_way():
    """A quaternion and its negative are one rotation: the shorter way is taken."""
    model = animated.bar(negative=True)
    model.write('bar.gltf')
    for time in (0.25, 0.5, 1):
        want = [[(1 - u) * x + u * y for x, y in zip(p, turn(p, (0, 10, 0), 90 * time))]
                for p, u in zip(model.position, model.upper)]
        near(vertices('bar.gltf', '--animation', 'bend', '--time', str(time))[0], want, 'the shorter way at %g s' % time)


def spline():
    """Hermite splines reproduce cubic polynomials: x = t^3 between keys at 1 and 3 seconds."""
    model = animated.slide()
    model.write('slide.gltf')
    for time in (1, 1.5, 2, 2.75, 3):
        got = vertices('slide.gltf', '--animation', 'slide', '--time', str(time))
        near(got[0], [(p[0] + time ** 3, p[1] - time, p[2]) for p in model.position], 'spline at %g s' % time)


def morph():
    model = animated.ball_that_grows()
    model.write('grow.gltf')
    for time, weight in ((0, 0), (0.5, 0.5), (1, 1)):
        got = vertices('grow.gltf', '--animation', 'grow', '--time', str(time))
        near(got[0], [[x * (1 + weight) for x in p] for p in model.position], 'morph at %g' % time)


def sizes():
    """--size-mm is the size of the bind pose, also at a moment when the ball has twice that."""
    model = animated.ball_that_grows()
    model.write('grow.gltf')
    low, high = zip(*((min(x), max(x)) for x in zip(*model.position)))
    for name, scale in (('size', ('--size-mm', '20')), ('scale', ('--mm-per-unit', str(20 / math.dist(low, high))))):
        prt('colors', 'grow.gltf', '--animation', 'grow', '--time', '1', '--material', 'marble', '--env', 'constant',
            '--term', 'multiple', '--cube', '16', '--samples', '200', *scale, '-o', name + '.csv', '--quiet')
    prt('compare', 'size.csv', 'scale.csv', '--max-rmse', '1e-5')


def nested():
    """A mesh below three turning nodes, without a skin."""
    model = animated.carousel()
    model.write('carousel.gltf')
    got = vertices('carousel.gltf', '--animation', 'turn', '--time', '0.5')
    want = []
    for p in model.position:
        for _ in range(3):
            p = turn(p, (0, 0, 0), 15)
            p = (p[0] + 2, p[1], p[2])
        want.append(p)
    near(got[0], want, 'nested nodes')
    bind = vertices('carousel.gltf')
    near(bind[0], [(p[0] + 6, p[1], p[2]) for p in model.position], 'the bind pose')


def names():
    """Animations without a name, or with another's, have one of their own, by which they are chosen."""
    model = animated.plain()
    for k, name in enumerate(('animation 1', '', 'animation 1', 'swim', '')):
        model.animate(name, 0, 'translation', [0.0, 1.0], [(0, 0, 0), (k + 1, 0, 0)], 'VEC3')
    model.write('names.gltf')
    found = json.loads(prt('info', 'names.gltf', '--json').stdout)['animations_s']
    expect(len(found) == 5 and {'animation 1', 'swim'} < set(found), 'five names: %s' % list(found))
    for k, name in enumerate(found):
        got = vertices('names.gltf', '--animation', name, '--time', '1')
        near(got[0], [(p[0] + k + 1, p[1], p[2]) for p in model.position], 'the animation %s' % name)


def at_rest():
    """Without an animation a skinned mesh stands where its joints have it, and morph targets have the file's weights."""
    model = animated.bar(node_translation=(5, 5, 5))
    model.data['nodes'][2]['scale'] = [3, 3, 3]
    model.data['nodes'][1]['rotation'] = animated.quaternion(90)
    for animations in (model.data['animations'], None):
        if animations is None:
            del model.data['animations']
        model.write('rest.gltf')
        near(vertices('rest.gltf')[0], [[(1 - u) * x + u * y for x, y in zip(p, turn(p, (0, 10, 0), 90))]
                                        for p, u in zip(model.position, model.upper)], 'a skin without an animation')
    model = animated.ball_that_grows()
    model.data['meshes'][0]['weights'] = [0.5]
    del model.data['animations']
    model.write('rest.gltf')
    near(vertices('rest.gltf')[0], [[1.5 * x for x in p] for p in model.position], 'a weight without an animation')


def instances():
    """EXT_mesh_gpu_instancing: the mesh once for each place, below the node's own transform."""
    for scale in (None, [(1, 1, 1), (2, 2, 2), (1, 3, 1)]):
        model = animated.plain()
        places = [(0, 0, 0), (10, 0, 0), (0, 20, 0)]
        attributes = {'TRANSLATION': model.accessor('VEC3', animated.FLOAT, places),
                      'ROTATION': model.accessor('VEC4', animated.FLOAT, [animated.quaternion(90 * i) for i in range(3)])}
        if scale:
            attributes['SCALE'] = model.accessor('VEC3', animated.FLOAT, scale)
        model.data['nodes'][0].update(translation=[1, 2, 3],
                                      extensions={'EXT_mesh_gpu_instancing': {'attributes': attributes}})
        model.data['extensionsUsed'] = model.data['extensionsRequired'] = ['EXT_mesh_gpu_instancing']
        model.write('many.gltf')
        want = []
        for i, (x, y, z) in enumerate(places):
            size = scale[i] if scale else (1, 1, 1)
            for p in model.position:
                q = turn([a * s for a, s in zip(p, size)], (0, 0, 0), 90 * i)
                want.append((q[0] + x + 1, q[1] + y + 2, q[2] + z + 3))
        near(vertices('many.gltf')[0], want, 'instances')
        expect(json.loads(prt('info', 'many.gltf', '--json').stdout)['mesh']['objects'] == 3, 'three objects')
    model.data['accessors'][attributes['SCALE']]['count'] = 2
    model.write('many.gltf')
    said = prt('info', 'many.gltf', status=1).said
    expect('instances have 2 SCALE of 3' in said, said)


def weights_of():
    """A morph target's weight is the animation's, else the node's, else the mesh's, else 0."""
    for mesh, node, animated_to, want in ((0.5, None, None, 0.5), (0.5, 0.25, None, 0.25), (0.5, 0.25, 1, 1),
                                          (None, 0.75, None, 0.75), (None, None, None, 0)):
        model = animated.plain()
        model.data['meshes'][0]['primitives'][0]['targets'] = [
            {'POSITION': model.accessor('VEC3', animated.FLOAT, model.position)}]
        if mesh is not None:
            model.data['meshes'][0]['weights'] = [mesh]
        if node is not None:
            model.data['nodes'][0]['weights'] = [node]
        if animated_to is None:
            model.animate('go', 0, 'translation', [0.0, 1.0], [(0, 0, 0), (3, 0, 0)], 'VEC3')
        else:
            model.animate('go', 0, 'weights', [0.0, 1.0], [0.0, float(animated_to)], 'SCALAR')
        model.write('weights.gltf')
        got = vertices('weights.gltf', '--animation', 'go', '--time', '1')
        moved = 3 if animated_to is None else 0
        near(got[0], [((1 + want) * p[0] + moved, (1 + want) * p[1], (1 + want) * p[2]) for p in model.position],
             'weights %s %s %s' % (mesh, node, animated_to))


def tool():
    animated.bar().write('bar.gltf')
    info = json.loads(prt('info', 'bar.gltf', '--json').stdout)
    expect(info['animations_s'] == {'bend': 1}, 'prt info: %s' % info.get('animations_s'))
    lit = ['--env', 'constant', '--material', 'marble', '--size', '40x30', '--size-mm', '20', '-o', 'x.png', '--quiet']
    prt('image', 'bar.gltf', '--engine', 'texture', '--scattering', 'dipole', '--animation', 'bend', '--time', '0.5', *lit)
    for words, text in ((['--animation', 'bond'], 'did you mean bend?'), (['--time', '1'], '--time is for'),
                        (['--animation', 'bend', '--time', 'nan'], 'time')):
        said = prt('image', 'bar.gltf', *words, *lit, status=2).said
        expect(text in said, said)
    animated.plain().write('plain.gltf')
    expect('has no animations' in prt('image', 'plain.gltf', '--animation', 'x', *lit, status=2).said, 'no animations')


def damaged():
    good = animated.bar().document()
    nan = float('nan')

    def change(text, edit):
        model = copy.deepcopy(good)
        edit(model)
        with open('bad.gltf', 'w', encoding='utf-8') as f:
            f.write(json.dumps(model))
        said = prt('colors', 'bad.gltf', '--env', 'constant', '--term', 'irradiance', '--material', 'marble',
                   '--mm-per-unit', '1', '--animation', 'bend', '-o', 'x.csv', status=1).said
        expect(text in said and said.count('\n') <= 2, '%s: %s' % (text, said))

    def channel(m):
        return m['animations'][0]['channels'][0]

    def sampler(m):
        return m['animations'][0]['samplers'][0]

    def attribute(m):
        return m['meshes'][0]['primitives'][0]['attributes']

    def data(m, accessor, values):
        animated.replace(m, accessor, values)

    def morphed(m, n):
        """By a target of n vectors, at full weight."""
        model = animated.Model()
        model.data = m
        target = model.accessor('VEC3', animated.FLOAT, [(1, 0, 0)] * n)
        m['meshes'][0].update(weights=[1])
        m['meshes'][0]['primitives'][0]['targets'] = [{'POSITION': target}]

    count = good['accessors'][attribute(good)['POSITION']]['count']
    change('node does not exist', lambda m: channel(m)['target'].update(node=99))
    change('sampler does not exist', lambda m: channel(m).update(sampler=-1))
    change('interpolation is unknown', lambda m: sampler(m).update(interpolation='CUBIC'))
    change('does not exist', lambda m: sampler(m).update(input=1e30))
    change('not as many values', lambda m: sampler(m).update(interpolation='CUBICSPLINE'))
    change('times do not increase', lambda m: data(m, sampler(m)['input'], [1.0, 0.5]))
    change('times do not increase', lambda m: data(m, sampler(m)['input'], [0.0, nan]))
    change('not finite', lambda m: data(m, sampler(m)['output'], [0, 0, 0, nan, 0, 0, 0, 1]))
    change('has no length', lambda m: data(m, sampler(m)['output'], [0.0] * 8))
    change('skin 7 does not exist', lambda m: m['nodes'][2].update(skin=7))
    change('is no node of the file', lambda m: m['skins'][0].update(joints=[0, 99]))
    change('is not in the scene', lambda m: (m['nodes'].append({}), m['skins'][0].update(joints=[0, 3])))
    change('no joints', lambda m: m['skins'][0].update(joints=[]))
    change('names joint 1 of 1', lambda m: m['skins'][0].update(joints=[0]))
    change('inverse bind matrices', lambda m: m['accessors'][m['skins'][0]['inverseBindMatrices']].update(count=1))
    change('components where 16', lambda m: m['skins'][0].update(inverseBindMatrices=attribute(m)['POSITION']))
    change('one element for each', lambda m: m['accessors'][attribute(m)['JOINTS_0']].update(count=3))
    for more in (-1, 1):
        change(' elements for %d vertices' % count, lambda m, n=count + more: morphed(m, n))
    change('unsigned whole numbers', lambda m: attribute(m).update(JOINTS_0=attribute(m)['WEIGHTS_0']))
    change('a weight of vertex', lambda m: data(m, attribute(m)['WEIGHTS_0'], [-1.0]))
    change('does not exist', lambda m: attribute(m).pop('WEIGHTS_0'))


main(bar, long_way, spline, morph, sizes, nested, names, at_rest, instances, weights_of, tool, damaged)
