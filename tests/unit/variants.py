#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Variants of a .prt: a request selects one, and those that change what was baked are refused.

   tests/unit/variants.py PATH/TO/prt"""
import json
import os
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import variant_model  # noqa: E402
from programs import expect, main, prt, same  # noqa: E402

BAKE = ['--mm-per-unit', '1000', '--cube', '16', '--samples', '1500', '--quiet']
LIT = ['--env', 'constant:1,.9,.8', '--quiet']


def bake(transport, name='', *more):
    out = '%s-%s.prt' % (transport, name or 'plain')
    prt('bake', 'v.glb', *BAKE, '--transport', transport, *(['--variant', name] if name else []), *more, '-o', out)
    return out


def image(source, out, *args):
    prt('image', source, *LIT, '--size', '96x64', '--camera', '.015,.03,.1:.015,0,0', *args, '-o', out)


def colors(source, out, *args, status=0):
    return prt('colors', source, *LIT, *args, '-o', out, status=status)


def data(path):
    with open(path, 'rb') as f:
        return f.read()


def looks_of_one_bake(transport):
    """A variant that leaves the bake alone: the same bytes as the bake of that variant gives."""
    plain = bake(transport)
    image(plain, 'plain.png')
    colors(plain, 'plain.npy')
    for name in ('day', 'dark'):
        own = bake(transport, name)
        image(own, 'own.png')
        image(plain, 'view.png', '--variant', name)
        expect(data('own.png') == data('view.png'), '%s: the picture of variant %s' % (transport, name))
        expect(data('plain.png') != data('view.png'), '%s: variant %s changes nothing' % (transport, name))
        image(own, 'own.exr', '--no-textures')
        image(plain, 'view.exr', '--no-textures', '--variant', name)
        same('own.exr', 'view.exr', 1e-3)
        colors(own, 'own.npy')
        colors(plain, 'view.npy', '--variant', name)
        same('own.npy', 'view.npy', 2e-6)
        image(own, 'back.png', '--variant', 'default')
        expect(data('back.png') == data('plain.png'), '%s: back from variant %s' % (transport, name))
    colors(plain, 'dark.npy', '--variant', 'dark')
    prt('compare', 'plain.npy', 'dark.npy', '--max-rmse', '.05', status=1)


def wavelet():
    looks_of_one_bake('wavelet')
    for name, text in (('jade', 'changes the medium of "skin"'), ('bumpy', 'another normal map for "skin"'),
                       ('clear', 'makes translucent "stone"')):
        said = colors('wavelet-plain.prt', 'x.npy', '--variant', name, status=1).stderr
        expect(text in said and 'needs a bake of its own' in said, said)
    said = colors('wavelet-plain.prt', 'x.npy', '--variant', 'dya', status=2).stderr
    expect('did you mean day?' in said, said)
    found = json.loads(prt('info', 'wavelet-plain.prt', '--json').stdout)
    expect(found['variants'] == [v[0] for v in variant_model.VARIANTS], 'variants: %s' % found['variants'])
    expect(sorted(found['variants_not_baked']) == ['bumpy', 'clear', 'jade'], str(found['variants_not_baked']))


def joint():
    """A joint bake edits the medium; one that the user chose stays."""
    colors(bake('joint'), 'plain.npy')
    own = bake('joint', 'jade')
    colors(own, 'own.npy')
    colors('joint-plain.prt', 'view.npy', '--variant', 'jade')
    same('own.npy', 'view.npy', 2e-3)
    prt('compare', 'plain.npy', 'view.npy', '--max-rmse', '.05', status=1)
    colors('joint-plain.prt', 'a.npy', '--material', 'wax=marble', status=2)
    colors('joint-plain.prt', 'a.npy', '--material', 'jade={"sigma_s_prime":[2,2,2],"sigma_a":[0.1,0.1,0.1],"eta":1.5}',
           '--variant', 'jade')
    prt('compare', 'a.npy', 'view.npy', '--max-rmse', '.05', status=1)
    prt('bake', 'v.glb', *BAKE, '--transport', 'joint', '--material',
        '{"name":"mine","sigma_s_prime":[2,2,2],"sigma_a":[0.1,0.1,0.1],"eta":1.5}', '-o', 'mine.prt')
    colors('mine.prt', 'mine.npy')
    colors('mine.prt', 'jade.npy', '--variant', 'jade')
    same('mine.npy', 'jade.npy', 0)


def unbaked():
    """Engines that need no bake answer for every variant, from the .prt and from the model."""
    for name in ('jade', 'bumpy', 'clear'):
        for engine in ('reference', 'splat'):
            more = ['--engine', engine, '--samples', '2000', '--seed', '3', '--variant', name]
            image('wavelet-plain.prt', 'view.exr', *more)
            image('v.glb', 'own.exr', *more, '--mm-per-unit', '1000', '--cube', '16')
            same('own.exr', 'view.exr', .002)
        more = ['--term', 'irradiance', '--variant', name]  # which no .prt holds
        colors('wavelet-plain.prt', 'view.npy', *more)
        colors('v.glb', 'own.npy', *more, '--mm-per-unit', '1000', '--cube', '16')
        same('own.npy', 'view.npy', .002)


def no_variants():
    variant_model.textured_ball.glb('plain.glb', [variant_model.textured_ball.flat((9, 9, 9))], variant_model.SKIN)
    prt('bake', 'plain.glb', *BAKE, '--transport', 'wavelet', '-o', 'plain.prt')
    said = colors('plain.prt', 'x.npy', '--variant', 'day', status=2).stderr
    expect('plain.prt has no variants' in said, said)


main(lambda: variant_model.write('v.glb'), wavelet, joint, unbaked, no_variants)
