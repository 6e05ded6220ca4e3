#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Poses of animations from a live relightd: its pictures are prt's of the same moment.

   tests/service/animation_daemon.py BIN"""
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import animated  # noqa: E402
from programs import daemon, expect, main, prt, relight  # noqa: E402

# one camera for all moments
LIT = ['--env', 'constant', '--size', '96x72', '--engine', 'texture', '--camera', '0,10,60:0,10,0',
       '--background', '0,0,0']


def pictures(load, name):
    relight('load', load, '--name', name, '--size-mm', '20', '--material', 'skin1', '--preview')
    poses = {}
    for moment in ('0', '0.5', '1', '7'):
        pose = poses[moment] = relight('pose', name, load, '--animation', 'bend', '--time', moment).stdout.strip()
        expect(len(pose) == 64, 'a pose: ' + pose)
        relight('image', name, *LIT, '--pose', pose, '-o', 'got.png')
        prt('image', load, *LIT, '--scattering', 'dipole', '--size-mm', '20', '--material', 'skin1', '--animation', 'bend', '--time',
            moment, '-o', 'want.png', '--quiet')
        prt('compare', 'got.png', 'want.png', '--max-rmse', '0.05')
    prt('compare', 'got.png', 'want.png')
    expect(poses['1'] == poses['7'] and len(set(poses.values())) == 3, 'names by content: %s' % poses)
    relight('image', name, *LIT, '-o', 'rest.png')
    prt('compare', 'rest.png', 'want.png', '--max-rmse', '0.2', status=1)


def edited_vertices():
    """Beside the colours of an edit lie the vertices of the pose."""
    relight('load', 'bar.gltf', '--name', 'baked', '--size-mm', '20', '--samples', '300', '--cube', '16', '--no-draft',
            '--wait')
    pose = relight('pose', 'baked', 'bar.gltf', '--animation', 'bend', '--time', '1').stdout.strip()
    edit = ['edit', 'baked', '--material', 'skin1', '--env', 'constant']
    for name, words in (('posed', ['--pose', pose]), ('rest', []), ('again', [])):
        relight(*edit, *words, '-o', name + '.ply')
    posed, rest, again = (open(name + '.ply', 'rb').read() for name in ('posed', 'rest', 'again'))
    expect(posed != rest and rest == again, 'the vertices of a pose')
    said = relight(*edit, '--pose', '0' * 64, '-o', 'posed.csv', status=1).said
    expect('pose' in said, 'a pose that is not there: ' + said)


def refusals():
    for words, status, text in ((['bar', 'bar.gltf', '--animation', 'bond'], 2, 'did you mean bend?'),
                                (['bar', 'bar.gltf'], 2, '--animation is missing'),
                                (['bar', '--animation', 'bend'], 2, 'FILE is missing'),
                                (['bar', 'grow.gltf', '--animation', 'grow'], 2, 'is it another model?'),
                                (['bar', 'plain.gltf', '--animation', 'x'], 2, 'has no animations'),
                                (['bar', 'bad.gltf', '--animation', 'bend'], 1, 'names joint 1 of 1'),
                                (['bar', 'no.gltf', '--animation', 'bend'], 1, 'no.gltf')):
        said = relight('pose', *words, status=status).said
        expect(text in said, '%s: %s' % (' '.join(words), said))


def serve():
    animated.bar().write('bar.gltf')
    animated.ball_that_grows().write('grow.gltf')
    animated.plain().write('plain.gltf')
    bad = animated.bar()
    bad.data['skins'][0]['joints'] = [0]
    bad.write('bad.gltf')
    beside = animated.bar()  # buffers in files of their own
    for i, buffer in enumerate(beside.data['buffers']):
        with open('part%d.bin' % i, 'wb') as f:
            f.write(animated.bytes_of(buffer))
        buffer['uri'] = 'part%d.bin' % i
    beside.write('beside.gltf')
    with daemon('--data', 'data'):
        pictures('bar.gltf', 'bar')
        pictures('beside.gltf', 'beside')
        edited_vertices()
        refusals()
        expect(not [f for f in os.listdir('data/work') if f.startswith('pose')], 'a folder is left behind')


main(serve)
