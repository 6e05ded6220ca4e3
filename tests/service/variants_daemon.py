#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Variants by request from a daemon: baked and before the bake, pictures, colours, coefficients,
HTTP, and refusals.

   tests/service/variants_daemon.py PATH/TO/bin PATH/TO/python"""
import json
import os
import sys
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
sys.path.insert(0, sys.argv[2])
import numpy  # noqa: E402
import relight as package  # noqa: E402
import variant_model  # noqa: E402
from programs import daemon, expect, main, prt, relight, run as program, same  # noqa: E402

LIT = ['--env', 'constant:1,.9,.8']
VIEW = [*LIT, '--size', '96x64', '--camera', '.015,.03,.1:.015,0,0']
BAKE = ['--mm-per-unit', '1000', '--cube', '16', '--samples', '1500', '--quiet']


def load(name, *args):
    relight('load', 'v.glb', '--name', name, '--mm-per-unit', '1000', *args)


def viewers(model, variant):
    """relight-preview and client/python answer as the daemon and prt do."""
    with package.Client('unix:socket') as client:
        listed = {m.name.split('.')[0]: m.variants for m in client.models()}
        expect(listed[model] == tuple(v[0] for v in variant_model.VARIANTS), 'LIST: %s' % listed)
        for form in ('f32', 'coefficients'):
            numpy.save('python.npy', client.colors(model, 'constant:1,.9,.8', variant=variant, format=form))
            same('own.npy', 'python.npy', 1e-3)
    program('relight-preview', '-s', 'unix:socket', model, *VIEW, '--variant', variant, '--format', 'f32', '-o', 'viewer.exr')
    relight('image', model, *VIEW, '--variant', variant, '-o', 'served.exr')
    same('served.exr', 'viewer.exr', .005)


def agree(model, baked, variant):
    """The daemon answers as prt does from the same file."""
    by = ['--variant', variant]
    relight('image', model, *VIEW, *by, '-o', 'served.png')
    prt('image', baked, *VIEW, *by, '-o', 'own.png', '--quiet')
    same('own.png', 'served.png', .01)
    prt('colors', baked, *LIT, *by, '-o', 'own.npy', '--quiet')
    for form in ('f32', 'coefficients'):
        relight('colors', model, *LIT, *by, '--format', form, '-o', 'served.npy')
        same('own.npy', 'served.npy', 1e-3)


def baked():
    for transport in ('wavelet', 'joint'):
        name = transport + '.prt'
        prt('bake', 'v.glb', *BAKE, '--transport', transport, '-o', name)
        relight('load', name, '--remote')
        told = json.loads(relight('info', transport, '--json').stdout)
        expect(told['variants'] == [v[0] for v in variant_model.VARIANTS], 'INFO: %s' % told.get('variants'))
        for variant in ('day', 'dark', 'default') + (('jade',) if transport == 'joint' else ()):
            agree(transport, name, variant)
            viewers(transport, variant)
        relight('image', transport, *VIEW, '-o', 'plain.png')
        prt('compare', 'plain.png', 'served.png', '--max-rmse', '.01', status=transport == 'joint')
    said = relight('image', 'wavelet', *VIEW, '--variant', 'jade', '-o', 'x.png', status=2).stderr
    expect('changes the medium of "skin"' in said and 'needs a bake of its own' in said, said)
    said = relight('colors', 'wavelet', *LIT, '--variant', 'dya', '-o', 'x.npy', status=2).stderr
    expect('did you mean day?' in said, said)
    said = relight('image', 'wavelet', *VIEW, '--variant', 'x' * 64, '-o', 'x.png', status=2).stderr
    expect('shade.variant: the name has more than 63 bytes' in said, said)


def other_index():
    """A variant of another refractive index needs a bake of its own, or one for any index."""
    for name, own in (('one-eta', []), ('any-eta', ['--any-eta'])):
        prt('bake', 'ior.glb', *BAKE, '--transport', 'joint', *own, '-o', name + '.prt')
        relight('load', name + '.prt', '--remote')
    said = relight('image', 'one-eta', *VIEW, '--variant', 'jade', '-o', 'x.png', status=2).stderr
    expect('changes the refractive index of "skin"' in said, said)
    agree('any-eta', 'any-eta.prt', 'jade')
    relight('image', 'any-eta', *VIEW, '-o', 'plain.png')
    prt('compare', 'plain.png', 'served.png', '--max-rmse', '.01', status=1)


def previews():
    """Before a bake every variant is drawn, also those that a bake would not hold for."""
    load('draft', '--preview')
    for _ in range(600):
        if json.loads(relight('info', 'draft', '--json').stdout)['state'] == 'preview':
            break
        time.sleep(.1)
    relight('image', 'draft', *VIEW, '--engine', 'splat', '-o', 'plain.exr')
    for variant in ('day', 'dark', 'jade', 'clear'):
        relight('image', 'draft', *VIEW, '--engine', 'splat', '--variant', variant, '-o', 'view.exr')
        prt('image', 'v.glb', *VIEW, '--mm-per-unit', '1000', '--engine', 'splat', '--scattering', 'dipole', '--variant',
            variant, '-o', 'own.exr', '--quiet')
        same('own.exr', 'view.exr', .002)
        prt('compare', 'plain.exr', 'view.exr', '--max-rmse', '.004', status=1)
    said = relight('image', 'draft', *VIEW, '--variant', 'noon', '-o', 'x.png', status=2).stderr
    expect('has no variant "noon"' in said, said)


def run():
    variant_model.write('v.glb')
    variant_model.write('ior.glb', jade_ior=1.4)
    with daemon('--data', 'data', '--models', '.'):
        baked()
        other_index()
        previews()


main(run)
