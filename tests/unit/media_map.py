#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Media by object through the prt program: --material OBJECT=NAME, the file's own media, refusals.

   tests/unit/media_map.py PATH/TO/prt"""
import csv
import json

import candle
from programs import expect, main, prt

FEW = ['--env', 'constant', '--samples', '2000', '--rays', '128', '--single-points', '16']
BAKE = ['--samples', '1500', '--cube', '16', '--no-single']


def colors(source, *options, status=0):
    run = prt('colors', source, '--env', 'constant', '-o', 'out.csv', *options, status=status)
    if status:
        return run.stderr
    with open('out.csv', encoding='utf-8') as f:
        return [[float(x) for x in row[1:]] for row in list(csv.reader(f))[1:]]


def media_of(path):
    info = json.loads(prt('info', path, '--json').stdout)
    return {(o['node'], o['material']): m['material']['name'] for m in info['media'] for o in m['objects']}


def differs(a, b, vertices):
    return max(abs(a[v][c] - b[v][c]) for v in vertices for c in range(3)) > 2e-3


def check_model():
    one = colors('candle.gltf', *FEW[2:], '--material', 'skin1')
    by_material = colors('candle.gltf', *FEW[2:], '--material', 'skin1', '--material', 'holder=ketchup')
    holders = [candle.vertices('pair', 1), candle.vertices('foot', 1)]
    waxes = [candle.vertices('candle', 0), candle.vertices('pair', 0)]
    for v in holders:
        expect(differs(one, by_material, v), 'holder=ketchup did not change a holder')
    expect(not differs(one, by_material, waxes[0]), 'holder=ketchup changed wax')
    # in one body light goes over from wax to holder; as two bodies it does not
    expect(differs(one, by_material, waxes[1]), 'the divided node is one body still')
    by_node = colors('candle.gltf', *FEW[2:], '--material', 'foot=ketchup', '--material', 'skin1')
    expect(differs(one, by_node, holders[1]), 'foot=ketchup did not change the foot')
    expect(not differs(one, by_node, holders[0]), 'foot=ketchup changed another holder')
    # an equal medium by another way is the same map
    same = colors('candle.gltf', *FEW[2:], '--material', 'holder=skin1', '--material', 'wax=skin1')
    expect(same == one, 'one medium for all differs from the same for each')
    # where nothing is said the file's own medium stays
    own = colors('candle.gltf', *FEW[2:], '--material', 'holder=ketchup')
    expect(not differs(own, by_material, holders[1]), "a holder beside the file's own wax differs")
    expect(differs(own, by_material, waxes[0]), "the file's own wax is not used")
    expect('has no material' in colors('candle.gltf', *FEW[2:], status=2), 'a holder without a medium')


def check_info():
    """The file's own medium in mm^-1, by the unit that is given."""
    def absorption(*options):
        mesh = json.loads(prt('info', 'candle.gltf', '--json', *options).stdout)['mesh']
        return [s['medium']['sigma_a'] for s in mesh['surfaces'] if 'medium' in s], mesh['diagonal']

    metres, diagonal = absorption()
    expect(metres, 'the wax has no medium')
    for options, unit in ((('--mm-per-unit', '500'), 500), (('--size-mm', str(2000 * diagonal)), 2000)):
        for a, b in zip(metres, absorption(*options)[0]):
            expect(all(abs(x * 1000 / unit - y) < 1e-5 * y for x, y in zip(a, b)), '%s: %s, %s' % (options, a, b))


def check_refusals():
    for options, text in ((['wex=skin1'], 'did you mean wax?'), (['wick=skin1'], 'it is opaque'),
                          (['wax=skin1', 'wax=ketchup'], 'another entry'),
                          (['wax=skin1', 'candle=ketchup'], 'another entry'),
                          (['skin1', 'ketchup'], 'for all objects'), (['wax=marbel'], 'marble'),
                          (['x' * 300 + '=skin1'], 'no translucent material or node'),
                          (['wax='], 'neither a file nor'), (['=skin1', 'marble'], '')):
        args = [x for o in options for x in ('--material', o)]
        said = colors('candle.gltf', *FEW[2:], *args, status=2)
        expect(text in said, '%s: %s' % (options, said))
        expect(len([x for x in said.splitlines() if x.startswith('error')]) == 1, 'one error line: ' + said)
    many = [x for i in range(65) for x in ('--material', 'wax%d=skin1' % i)]
    expect('at most 64' in colors('candle.gltf', *FEW[2:], *many, status=2), '65 materials')


def check_bakes():
    # one name in two nodes; "pair" has two media, so that it is two bodies
    run = prt('bake', 'candle.gltf', *BAKE, '--material', 'wax=marble', '--material', 'holder=ketchup',
              '-o', 'fixed.prt')
    expect('divided' in run.stderr, 'the division of a node is not said: ' + run.stderr)
    expect(media_of('fixed.prt') == {('candle', 'wax'): 'marble', ('pair', 'wax'): 'marble',
                                     ('pair', 'holder'): 'ketchup', ('foot', 'holder'): 'ketchup'},
           'media of fixed.prt: %s' % media_of('fixed.prt'))
    expect('fixed by the bake' in colors('fixed.prt', '--material', 'wax=skin1', status=2), 'a fixed medium')
    prt('compare', 'fixed.prt', 'reference', '--env', 'constant', '--term', 'multiple', '--samples', '8000',
        '--rays', '512', '--max-rmse', '0.02')
    prt('bake', 'candle.gltf', *BAKE, '--transport', 'joint', '--material', 'wax=marble', '--material',
        'holder=ketchup', '-o', 'free.prt')
    before = colors('free.prt')
    after = colors('free.prt', '--material',
                   'holder={"sigma_s_prime":[1,1,1],"sigma_a":[0.1,0.2,0.3],"eta":1.3}')
    for v in (candle.vertices('candle', 0), candle.vertices('pair', 0), candle.vertices('thread', 2)):
        expect([before[i] for i in v] == [after[i] for i in v], 'an edit of the holder changed others')
    expect(differs(before, after, candle.vertices('foot', 1)), 'an edit of the holder changed nothing')
    expect('eta is 1.3' in colors('free.prt', '--material', 'wax=skin1', status=2), 'another eta')
    expect('did you mean holder?' in colors('free.prt', '--material', 'holdr=ketchup', status=2), 'a typo')
    # pictures of both
    for source in ('fixed.prt', 'free.prt'):
        prt('image', source, '--env', 'constant', '--size', '80x60', '-o', source + '.png')
    # a node of two media, baked as one body, is not edited in part
    prt('bake', 'candle.gltf', *BAKE, '--transport', 'joint', '--material', 'ketchup', '-o', 'one.prt')
    expect('one body' in colors('one.prt', '--material', 'holder=skin1', status=2), 'a part of a body')
    colors('one.prt', '--material', 'foot=skin1')


def model():
    candle.write('candle.gltf')


main(model, check_model, check_info, check_refusals, check_bakes)
