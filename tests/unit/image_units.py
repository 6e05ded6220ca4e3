#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A body looks the same whatever the unit of its file: the eye and the camera are in that unit.

   tests/unit/image_units.py PATH/TO/prt"""
import candle
from programs import main, prt, same

MM_PER_UNIT = (1, 10, 1000)
BALL = candle.ball((2, 1, 0), (8, 6, 8), 8)
EYE, TARGET = (20, 30, 60), (2, 1, 0)
FEW = ['--material', 'skin1', '--env', 'constant:1,.9,.8', '--engine', 'reference', '--samples', '2000', '--rays', '64',
       '--single-points', '64', '--quiet']


def write(path, unit):
    position, triangle = BALL
    with open(path, 'w', encoding='utf-8') as f:
        f.writelines('v %.9g %.9g %.9g\n' % tuple(x / unit for x in p) for p in position)
        f.writelines('f %d %d %d\n' % tuple(v + 1 for v in t) for t in triangle)


def vector(v, unit):
    return ','.join('%.9g' % (x / unit) for x in v)


def every_unit(name, run):
    """run(unit, out) writes a file of name's ending; those of all units are the same."""
    out = ['%d-%s' % (unit, name) for unit in MM_PER_UNIT]
    for unit, path in zip(MM_PER_UNIT, out):
        run(['ball-%d.obj' % unit, *FEW, '--mm-per-unit', str(unit)], unit, path)
    for path in out[1:]:
        same(path, out[0], 4e-3)  # rays that graze the ball differ by their rounding


def pictures():
    for unit in MM_PER_UNIT:
        write('ball-%d.obj' % unit, unit)
    for term in ('single', 'total'):
        every_unit(term + '.exr', lambda args, unit, out, term=term: prt(
            'image', *args, '--term', term, '--size', '48x36', '--camera',
            '%s:%s:0,1,0:30' % (vector(EYE, unit), vector(TARGET, unit)), '-o', out))


def colours():
    every_unit('single.npy', lambda args, unit, out: prt(
        'colors', *args, '--term', 'single', '--eye', vector(EYE, unit), '-o', out))


main(pictures, colours)
