#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Parts of models by name: objects, groups and materials of OBJ files, variants of glTF files.

   tests/unit/parts.py PATH/TO/prt"""
import json
import os
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import candle  # noqa: E402
from programs import expect, main, prt  # noqa: E402

LIT = ['--env', 'constant', '--size-mm', '20', '--cube', '16', '--samples', '2000']


def info(path, *args):
    done = prt('info', path, '--json', *args)
    return json.loads(done.stdout), done.stderr


def rows(path):
    with open(path, encoding='utf-8') as f:
        return f.read().split('\n')[1:-1]


def obj(path, parts, faces_last=False):
    """parts: (lines before its faces, centre); with faces_last all vertices come first."""
    head, tail, at = [], [], 1
    for lines, centre in parts:
        position, triangle = candle.ball(centre, (5, 5, 5), 7)
        vertices = ['v %.9g %.9g %.9g' % tuple(p) for p in position]
        faces = lines + ['f %d %d %d' % tuple(at + i for i in t) for t in triangle if len({
            tuple(position[i]) for i in t}) == 3]
        at += len(position)
        head += vertices if faces_last else vertices + faces
        tail += faces if faces_last else []
    with open(path, 'w', encoding='utf-8') as f:
        f.write('\n'.join(head + tail) + '\n')


def summary(path, *args):
    found, said = info(path, *args)
    return [(s['name'], s['translucent']) for s in found['mesh']['surfaces']], found['mesh']['objects'], said


def colors(path, *args):
    prt('colors', path, *LIT, *args, '-o', 'out.csv', '--quiet')
    return rows('out.csv')


def objects():
    far, one, two = (30, 0, 0), ['o left', 'usemtl wax'], ['o right', 'usemtl jade']
    for name, parts, late in (('o.obj', [(one, (0, 0, 0)), (two, far)], False),
                              ('late.obj', [(one, (0, 0, 0)), (two, far)], True),
                              ('g.obj', [(['g left', 'usemtl wax'], (0, 0, 0)), (['g right', 'usemtl jade'], far)],
                               False)):
        obj(name, parts, late)
        surfaces, n, _ = summary(name)
        expect(surfaces == [('wax', True), ('jade', True)] and n == 2, '%s: %s, %d objects' % (name, surfaces, n))
        both = colors(name, '--material', 'marble')
        for words in (['wax=marble', 'jade=ketchup'], ['left=marble', 'right=ketchup']):
            mixed = colors(name, '--material', words[0], '--material', words[1])
            half = len(both) // 2
            expect(mixed[:half] == both[:half] and mixed[half:] != both[half:], '%s by %s' % (name, words))
        _, _, said = summary(name, '--opaque', 'jade')
        expect(summary(name, '--opaque', 'right')[0] == [('wax', True), ('jade', False)], name + ' opaque')
        del said
    # an object of two materials is one object; two objects of one material are two
    one = [['o left', 'usemtl wax'], ['usemtl jade']]
    obj('two.obj', [(one[0], (0, 0, 0)), (one[1], far)])
    expect(summary('two.obj')[1] == 1, 'one object of two materials')
    obj('same.obj', [(['o left', 'usemtl wax'], (0, 0, 0)), (['o right', 'usemtl wax'], far)])
    expect(summary('same.obj')[1] == 2, 'two objects of one material')
    # groups that touch are regions of one body: each may still have its material
    obj('touch.obj', [(['g left', 'usemtl wax'], (0, 0, 0)), (['g right', 'usemtl jade'], (0, 10, 0))])
    surfaces, n, _ = summary('touch.obj')
    expect(n == 1 and len(surfaces) == 2, 'groups that touch: %d objects, %s' % (n, surfaces))
    # faces of two materials that share vertices are one part, with a warning
    obj('shared.obj', [(['usemtl wax'], (0, 0, 0))])
    with open('shared.obj', 'a', encoding='utf-8') as f:
        f.write('usemtl jade\nf 1 30 40\n')
    surfaces, n, said = summary('shared.obj')
    expect(surfaces == [('wax', True)] and n == 1 and 'share vertices' in said, 'shared: %s %s' % (surfaces, said))
    expect('opaque' not in said, said)
    for name in ('jade', 'wax'):
        surfaces, n, said = summary('shared.obj', '--opaque', name)
        expect(surfaces == [('wax', False)] and 'makes the whole model opaque' in said, 'shared: %s' % said)
    with open('many.obj', 'w', encoding='utf-8') as f:
        for i in range(300):
            f.write('o part%d\nv %d 0 0\nv %d 1 0\nv %d 0 1\nf -3 -2 -1\n' % (i, i, i, i))
    expect(summary('many.obj')[1] == 1, 'more parts than are told apart')
    _, _, said = summary('many.obj', '--opaque', 'part7')
    expect('more than 256 objects and materials: an opaque part makes the whole' in said, said)


def variants():
    candle.write('plain.gltf')
    with open('plain.gltf', encoding='utf-8') as f:
        model = json.load(f)
    model['extensions'] = {'KHR_materials_variants': {'variants': [{'name': 'day'}, {'name': 'night'}, {}]}}
    model['meshes'][0]['primitives'][0]['extensions'] = {'KHR_materials_variants': {'mappings': [
        {'material': 1, 'variants': [1]}, {'material': 99, 'variants': [2]}, {'material': 'x', 'variants': 3}]}}
    with open('v.gltf', 'w', encoding='utf-8') as f:
        json.dump(model, f)
    expect(info('v.gltf')[0]['variants'] == ['day', 'night', 'variant 2'], 'names of variants')
    lit = ['--env', 'constant', '--cube', '16', '--samples', '2000', '--material', 'wax=marble', '--material',
           'holder=skin1', '--quiet']
    part = candle.vertices('candle', 0)
    for variant, moved in ((None, False), ('day', False), ('ni', True), ('variant 2', False)):
        prt('colors', 'v.gltf', *lit, *(['--variant', variant] if variant else []), '-o', 'out.csv')
        got = rows('out.csv')
        own = got if not variant else own
        expect((got[part.start:part.stop] != own[part.start:part.stop]) == moved, 'variant %s' % variant)
        expect(got[part.stop:] == own[part.stop:], 'the others in variant %s' % variant)
    for path, name, text in (('v.gltf', 'nigth', 'did you mean night?'), ('plain.gltf', 'day', 'has no variants')):
        said = prt('info', path, '--variant', name, status=2).stderr
        expect(text in said, said)


main(objects, variants)
