#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Pins and a decision on a real model with textures under a measured light: drawn again they have
the same bytes on the same build, with one thread and several, and look the same on every other
instruction set: before they are rounded, and every pixel after it.

   tests/service/room_real.py BIN MODEL LIGHT"""
import hashlib
import json
import os
import subprocess
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'unit'))
from programs import daemon, expect, main, prt, relight, same  # noqa: E402

MODEL, LIGHT = sys.argv[2:4]
ROOM = 'a real model'
ENGINES = ('', 'splat', 'tangent', 'texture', 'hybrid')
STORE = ['--data', 'data', '--models', 'models']


def room(*words, status=0):
    return relight('room', *words, status=status)


def supported(isa):
    """Whether this processor has the instruction set."""
    with open('/proc/cpuinfo', encoding='utf-8') as f:
        words = set(f.read().split())
    needs = {'c': set(), 'avx2': {'avx2', 'fma'}, 'avx512': {'avx512f', 'avx512bw'}, 'neon': {'asimd'}}
    return needs[isa] <= words


def review():
    """One pin an engine, and a decision; returns the rooms' words for their pictures."""
    relight('load', 'spot.prt')
    room('create', ROOM, '--model', 'spot', '--env', LIGHT, '--rotate', '40', '--orbit', '30,20', '--size', '320x240')
    shown = []
    for i, engine in enumerate(ENGINES):
        if engine:
            room('scene', ROOM, '--engine', engine)
        said = json.loads(room('pin', ROOM, 'seen by ' + (engine or 'the bake'), '--at', '0,%d,0.3,0.2' % (700 * i),
                               '--json').stdout)
        shown.append(('pin-%d' % i, [str(said['sequence'])]))
    said = json.loads(room('approve', ROOM, 'as agreed', '--json').stdout)
    return shown + [('decision', ['--decision', str(said['sequence'])])]


def draw(shown, prefix):
    for name, words in shown:
        room('show', ROOM, *words, '-o', '%s-%s.png' % (prefix, name))
    room('show', ROOM, *shown[0][1], '-o', prefix + '.exr')


def read(path):
    with open(path, 'rb') as f:
        return f.read()


def check_hashes(shown):
    """What the room bound is the picture that it draws."""
    state = json.loads(room('show', ROOM, '--json').stdout)
    seen = [one['seen'] for one in state['pins'] + state['decisions']]
    expect(len(seen) == len(shown), '%d of %d are there' % (len(seen), len(shown)))
    for (name, _), one in zip(shown, seen):
        expect(one['picture_hash'] == hashlib.sha256(read('first-%s.png' % name)).hexdigest(),
               name + ': its picture has another hash')
        expect(len(one['mesh_hash']) == 16 and len(one['bake_hash']) == 16, name + ': %s' % one)
    expect(len({read('first-%s.png' % name) for name, _ in shown}) >= 3, 'the engines draw the same')


def check():
    os.mkdir('models')
    prt('bake', MODEL, '--size-mm', '50', '--material', 'marble', '--samples', '3000', '--cube', '16', '--draft',
        '-o', 'models/spot.prt', '--quiet')
    with daemon(*STORE, '--threads', '2'):
        shown = review()
        draw(shown, 'first')
        check_hashes(shown)
    with daemon(*STORE, '--threads', '1'):
        draw(shown, 'again')
    for name, _ in shown:
        expect(read('first-%s.png' % name) == read('again-%s.png' % name),
               name + ': other bytes after a restart, with one thread')
    for isa in ('c', 'avx2', 'avx512', 'neon'):
        if not supported(isa):
            continue
        with daemon(*STORE, '--cpu', isa):
            draw(shown, isa)
        same(isa + '.exr', 'first.exr', 2e-3)
        for name, _ in shown:
            done = subprocess.run([sys.executable, os.path.join(HERE, 'picture_difference.py'),
                                   'first-%s.png' % name, '%s-%s.png' % (isa, name), '0.5'],
                                  capture_output=True, text=True, check=False)
            print(done.stdout.strip())
            expect(not done.returncode, '%s on %s: %s' % (name, isa, done.stderr))


if not (os.path.exists(MODEL) and os.path.exists(LIGHT)):
    print('skipped: %s or %s is not there' % (MODEL, LIGHT))
    sys.exit(1 if os.environ.get('PRT_REQUIRE_DATA') == '1' else 77)
main(check)
