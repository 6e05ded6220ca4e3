#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""No program of ours ends with memory that nothing points to, and relightd keeps no descriptor: each runs under
the leak sanitizer, which ends it with a status of its own.  leaks.py BIN LIBLSAN"""
import os
import subprocess
import sys
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import candle  # noqa: E402
import variant_model  # noqa: E402
from programs import BIN, daemon, expect, main, prt, relight, run  # noqa: E402

MARBLE = ['--material', 'marble', '--size-mm', '20']
SMALL = ['--samples', '300', '--cube', '16']
LIT = ['--env', 'sky.exr']
TWO = ['--env', 'sky.exr', '--env', 'constant', '--gain', '1', '--gain', '0.5']
SIZE = ['--size', '48x36']
OWN = '{"name":"own","sigma_s_prime":[1,2,1],"sigma_a":[0.1,0.01,0.1],"g":0.2,"eta":1.3,"roughness":0.1}'
OBJ = ''.join('v %s\n' % v for v in ('1 0 0', '-1 0 0', '0 1 0', '0 -1 0', '0 0 1', '0 0 -1')) + ''.join(
    'f %s\n' % f for f in ('1 3 5', '3 2 5', '2 4 5', '4 1 5', '3 1 6', '2 3 6', '4 2 6', '1 4 6'))


def preload():
    """Every program that is started from here on is watched; 77 where the sanitizer cannot stop threads."""
    with open('known', 'w', encoding='utf-8') as f:
        f.write('leak:libOSMesa\nleak:libgallium\nleak:libLLVM\n')  # of the drawing library, not ours
    os.environ['LD_PRELOAD'] = sys.argv[2]
    os.environ['LSAN_OPTIONS'] = 'exitcode=23:print_suppressions=0:suppressions=' + os.path.abspath('known')
    probe = subprocess.run([os.path.join(BIN, 'prt'), '--version'], capture_output=True, text=True, check=False)
    if probe.returncode:
        print('skipped: the leak sanitizer does not run here: ' + probe.stderr[-300:])
        sys.exit(77)


def tool():
    """prt: bakes of each engine and estimator, and what is made of them."""
    with open('small.obj', 'w', encoding='utf-8') as f:
        f.write(OBJ)
    candle.write('candle.gltf')
    prt('env', 'constant:1,0.5,0.2', '-o', 'sky.exr')
    prt('bake', 'small.obj', *MARBLE, *SMALL, '--checkpoint', 'k', '-o', 'wavelet.prt')
    prt('bake', 'small.obj', '--size-mm', '20', *SMALL, '--transport', 'joint', '--scattering', 'walk', '--walks', '16',
        '--no-single', '-o', 'joint.prt')
    prt('bake', 'small.obj', '--size-mm', '20', *SMALL, '--transport', 'polynomial', '--env', 'sky.exr', '--no-single', '-o',
        'polynomial.prt')
    for part in ('0/2', '1/2'):
        prt('bake', 'candle.gltf', *SMALL, '--no-single', '--material', 'marble', '--shard', part, '-o', 'parts.prt')
    prt('colors', 'wavelet.prt', *LIT, '-o', 'a.csv')
    prt('colors', 'joint.prt', *LIT, '--material', OWN, '-o', 'b.npy')
    prt('image', 'joint.prt', *LIT, *SIZE, '--material', 'skin1', '-o', 'a.png')
    for engine in ('texture', 'splat'):
        prt('image', 'candle.gltf', *LIT, *SIZE, '--material', 'wax=' + OWN, '--material', 'skin1', '--engine', engine,
            '--floor', '-o', 'b.exr')
    prt('image', 'small.obj', *MARBLE, *LIT, *SIZE, '--samples', '300', '--term', 'difference', '--engine', 'reference',
        '--scattering', 'walk', '--walks', '16', '-o', 'difference.png')
    variant_model.write('variants.glb')
    prt('bake', 'variants.glb', *SMALL, '--no-single', '-o', 'variants.prt')
    prt('colors', 'variants.prt', *LIT, '--variant', 'dark', '-o', 'c.csv')
    prt('compare', 'a.png', 'a.png')
    prt('compare', 'joint.prt', 'reference', '--env', 'sky.exr', '--materials', 'skin1', '--samples', '100', '--rays', '16',
        '--vertices', '2', '--term', 'multiple')
    for file in ('wavelet.prt', 'candle.gltf', 'sky.exr'):
        prt('info', file, '--json')
    prt('material', 'marble', '-o', 'marble.json')
    prt('image', 'candle.gltf', *LIT, *SIZE, '--material', 'nothing', '-o', 'x.png', status=2)


def visit(n):
    """What a client asks in one visit."""
    with open('models/new%d.obj' % n, 'w', encoding='utf-8') as f:
        f.write(OBJ.replace('v 1 ', 'v 1.%d ' % n))
    ball = 'ball%d' % n
    relight('ping')
    relight('load', 'small.obj', '--size-mm', '2%d' % n, '--material', 'marble', *SMALL, '--name', ball, '--wait')
    relight('load', 'candle.gltf', '--name', 'candle', '--material', 'wax=' + OWN, '--material', 'skin1', '--preview')
    relight('load', 'new%d.obj' % n, '--remote', *MARBLE, '--name', 'new', '--preview')
    relight('models', '--json')
    relight('info', 'candle', '--json')
    relight('colors', ball, *TWO, '-o', 'a.csv')
    relight('image', ball, *TWO, *SIZE, '-o', 'a.png')
    relight('image', 'candle', *LIT, *SIZE, '--engine', 'texture', '-o', 'a.jpg')
    relight('image', 'candle', *LIT, *SIZE, '--engine', 'splat', '--floor', '-o', 'a.exr')
    relight('edit', 'candle', *LIT, *SIZE, '--engine', 'texture', '--material', OWN, '-o', 'a.png')
    relight('geometry', ball, '-o', 'a.ply')
    run('relight-preview', '-s', 'unix:socket', ball, *LIT, *SIZE, '--frames', '2', '-o', 'a.png')
    relight('image', 'nobody', *LIT, *SIZE, '-o', 'x.png', status=1)
    relight('room', 'create', 'R%d' % n, '--model', ball, '--env', 'constant', *SIZE)
    relight('room', 'pin', 'R%d' % n, 'a pin', '--at', '0,2,0.3,0.2')
    relight('room', 'scene', 'R%d' % n, '--exposure', '1')
    relight('room', 'approve', 'R%d' % n)
    relight('room', 'show', 'R%d' % n, '-o', 'a.png')
    relight('room', 'compare', 'R%d' % n, '1', '2', '-o', 'a.png')
    relight('room', 'export', 'R%d' % n, '-o', 'room%d' % n)
    relight('room', 'import', 'R%d' % n, 'room%d/pins.bcf' % n)
    relight('room', 'variant', 'R%d' % n, 'red', '--material', 'ketchup')
    relight('room', 'undo', 'R%d' % n)
    relight('room', 'invite', 'R%d' % n, 'Eve', '--role', 'viewer', '--expires', '1h')
    relight('room', 'member', 'R%d' % n, 'token:anna', '--role', 'reviewer')
    relight('room', 'anchors', 'R%d' % n)
    relight('room', 'log', 'R%d' % n)
    relight('room', 'close', 'R%d' % n)
    relight('room', 'backup', '-o', 'rooms.sqlite')
    relight('events', '--json')
    env = relight('env', 'sky.exr').stdout.strip()
    relight('download', env, '-o', 'back.exr')
    relight('unload', 'new', '--forget')
    relight('room', 'list')
    relight('stats', '--json')


def server():
    """relightd: two visits, after the second of which it has no more descriptors than after the first."""
    os.mkdir('models')
    with daemon('--models', 'models', '--data', 'data', '--poll', '0.2', '--http', '127.0.0.1:0') as process:
        folder = '/proc/%d/fd' % process.pid
        visit(1)
        time.sleep(1)
        before = len(os.listdir(folder))
        visit(2)
        visit(3)
        end = time.monotonic() + 20
        while len(os.listdir(folder)) > before and time.monotonic() < end:
            time.sleep(0.1)
        links = [os.readlink(os.path.join(folder, n)) for n in os.listdir(folder)]
        expect(len(links) <= before, 'descriptors: %d, then %s' % (before, sorted(links)))
    expect(process.returncode == 0, 'relightd ends with %s' % process.returncode)
    # its tokens are read again
    with daemon('--models', 'models', '--data', 'data') as process:
        for name in ('anna', 'bert'):
            relight('token', 'create', '--name', name, '--scope', 'view')
        relight('token', 'revoke', '--name', 'anna')
        relight('token', 'list')
    expect(process.returncode == 0, 'relightd ends with %s' % process.returncode)


main(preload, tool, server)
