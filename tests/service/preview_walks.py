#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Previews of a live relightd that are scaled to what walks return: the picture is prt's, the note says the ratio and
its error, an edited medium has the ratio of the one before until its own is there, and --preview-walks=no has none.

   tests/service/preview_walks.py BIN"""
import json
import os
import sys
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
from programs import daemon, expect, main, prt, relight, same  # noqa: E402

PICTURE = ['--env', 'constant', '--size', '96x72', '--engine', 'texture', '--background', '0,0,0']
SCALE = ['--size-mm', '10']
SCALED = 'scaled to walks:'


def write_plate(path, thickness=0.1):
    """A plate of 2 x 2 and this thickness, whose triangles are large: 12 of them."""
    at = [(x, y * thickness / 2, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    with open(path, 'w', encoding='utf-8') as out:
        for p in at:
            out.write('v %g %g %g\n' % p)
        for face in faces:
            out.write('f %d %d %d %d\n' % face)


def picture(out, *options):
    return json.loads(relight('image', 'plate', *PICTURE, *options, '-o', out, '--json').stdout)['note']


def wait_scaled(*options):
    """The note of a picture with the medium's own ratio, and those of the pictures before it."""
    before = []
    for _ in range(1200):
        note = picture('got.exr', *options)
        if SCALED in note:
            return note, before
        before.append(note)
        time.sleep(0.1)
    raise AssertionError('never scaled: ' + note)


def scaled():
    relight('load', 'plate.obj', *SCALE, '--material', 'skimmilk', '--preview', '--name', 'plate')
    note, _ = wait_scaled()
    expect('error 0.' in note or 'error 1.' in note or 'error 2.' in note, 'the ratio has no error: ' + note)
    prt('image', 'plate.obj', *SCALE, '--material', 'skimmilk', *PICTURE, '-o', 'want.exr')
    same('got.exr', 'want.exr', 0.05)
    prt('image', 'plate.obj', *SCALE, '--material', 'skimmilk', *PICTURE, '--scattering', 'dipole', '-o', 'dipole.exr')
    prt('compare', 'dipole.exr', 'want.exr', '--max-rmse', '0.1', status=1)
    # another medium
    first = picture('x.exr', '--material', 'skin1')
    expect('of the medium before' in first or SCALED in first, 'an edit lost the ratio: ' + first)
    wait_scaled('--material', 'skin1')
    prt('image', 'plate.obj', *SCALE, '--material', 'skin1', *PICTURE, '-o', 'want.exr')
    same('got.exr', 'want.exr', 0.05)


def unscaled():
    relight('load', 'plate.obj', *SCALE, '--material', 'skimmilk', '--preview', '--name', 'plate')
    for _ in range(2):
        expect('scaled' not in picture('got.exr'), 'a preview is scaled')
    same('got.exr', 'dipole.exr', 0.05)


def check():
    write_plate('plate.obj')
    with daemon('--data', 'data', '--preview-walks=yes'):
        scaled()
    with daemon('--data', 'other'):
        unscaled()


main(check)
