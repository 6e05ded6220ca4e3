#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A bake by random walks that a live relightd orders: colours, coefficients and pictures are prt's.

   tests/service/walk_daemon.py BIN"""
import math
import os
import sys


sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
from programs import daemon, expect, main, prt, relight, same  # noqa: E402

SETTINGS = ['--size-mm', '10', '--material', 'skin1', '--samples', '2000', '--cube', '16', '--seed', '3']
WALKS = ['--scattering', 'walk', '--walks', '16']


def write_ball(path, n=12):
    """A closed ball of 2n x n squares."""
    with open(path, 'w', encoding='utf-8') as out:
        for y in range(1, n):
            for x in range(2 * n):
                a, b = math.pi * y / n, math.pi * x / n
                out.write('v %.6f %.6f %.6f\n' % (math.sin(a) * math.cos(b), math.cos(a), math.sin(a) * math.sin(b)))
        out.write('v 0 1 0\nv 0 -1 0\n')
        top = 2 * n * (n - 1) + 1
        for x in range(2 * n):
            right = (x + 1) % (2 * n)
            out.write('f %d %d %d\n' % (top, right + 1, x + 1))
            for y in range(n - 2):
                a, b = 2 * n * y + 1, 2 * n * (y + 1) + 1
                out.write('f %d %d %d\nf %d %d %d\n' % (a + x, a + right, b + right, a + x, b + right, b + x))
            last = 2 * n * (n - 2) + 1
            out.write('f %d %d %d\n' % (top + 1, last + x, last + right))


def check():
    lit = ['--env', 'constant', '--rotate', '30']
    prt('bake', 'ball.obj', *SETTINGS, *WALKS, '-o', 'want.prt', '--quiet')
    relight('load', 'ball.obj', *SETTINGS, *WALKS, '--name', 'walked', '--wait')
    for term in ('total', 'multiple', 'single'):
        prt('colors', 'want.prt', *lit, '--term', term, '-o', 'want.csv')
        relight('colors', 'walked', *lit, '--term', term, '-o', 'got.csv')
        same('got.csv', 'want.csv', 1e-5)
    prt('colors', 'want.prt', *lit, '-o', 'want.csv')
    relight('colors', 'walked', *lit, '--format', 'coefficients', '-o', 'got.csv')
    same('got.csv', 'want.csv', 2e-3)
    picture = [*lit, '--size', '96x72']
    prt('image', 'want.prt', *picture, '-o', 'want.png')
    relight('image', 'walked', *picture, '-o', 'got.png')
    same('got.png', 'want.png', 0.02)
    # the dipole's bake is another model
    relight('load', 'ball.obj', *SETTINGS, '--name', 'dipole', '--wait')
    relight('colors', 'dipole', *lit, '-o', 'dipole.csv')
    prt('compare', 'dipole.csv', 'want.csv', '--max-rmse', '0.03', status=1)
    said = relight('load', 'ball.obj', *SETTINGS, '--scattering', 'walk', '--walks', '3', status=2).said
    expect('16 to 1048576' in said, 'too few walks: ' + said)
    free_media(lit)


def free_media(lit):
    """Walks of a free medium: the daemon edits it, and its answers are prt's."""
    settings = ['--size-mm', '10', '--samples', '2000', '--cube', '16', '--seed', '3', *WALKS]
    prt('bake', 'ball.obj', *settings, '-o', 'free.prt', '--quiet')
    relight('load', 'ball.obj', *settings, '--name', 'joint', '--wait')
    for medium in ('skin1', 'ketchup'):
        given = ['--material', medium]
        prt('colors', 'free.prt', *given, *lit, '-o', 'want.csv')
        relight('colors', 'joint', *given, *lit, '-o', 'got.csv')
        same('got.csv', 'want.csv', 1e-5)


def serve():
    write_ball('ball.obj')
    with daemon('--data', 'data'):
        check()


main(serve)
