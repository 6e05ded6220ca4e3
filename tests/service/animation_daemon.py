#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Poses of animations from a live relightd: its pictures are prt's of the same moment.

   tests/service/animation_daemon.py BIN"""
import os
import subprocess
import sys
import tempfile
import time

BIN = os.path.abspath(sys.argv[1])
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import animated  # noqa: E402

failed = 0
# one camera for all moments
LIT = ['--env', 'constant', '--size', '96x72', '--engine', 'texture', '--camera', '0,10,60:0,10,0',
       '--background', '0,0,0']


def expect(good, text):
    global failed
    if not good:
        failed += 1
        print('FAIL: ' + text)


def run(program, *args, status=0):
    done = subprocess.run([os.path.join(BIN, program), *args], capture_output=True, text=True, timeout=300)
    expect(done.returncode == status,
           '%s %s: status %d: %s' % (program, ' '.join(args), done.returncode, done.stderr))
    return done.stdout + done.stderr


def relight(*args, status=0):
    return run('relight', '-s', 'unix:socket', *args, status=status)


def pictures(load, name):
    relight('load', load, '--name', name, '--size-mm', '20', '--material', 'skin1', '--preview')
    poses = {}
    for moment in ('0', '0.5', '1', '7'):
        pose = poses[moment] = relight('pose', name, load, '--animation', 'bend', '--time', moment).strip()
        expect(len(pose) == 64, 'a pose: ' + pose)
        relight('image', name, *LIT, '--pose', pose, '-o', 'got.png')
        run('prt', 'image', load, *LIT, '--size-mm', '20', '--material', 'skin1', '--animation', 'bend', '--time',
            moment, '-o', 'want.png', '--quiet')
        run('prt', 'compare', 'got.png', 'want.png', '--max-rmse', '0.05')
    run('prt', 'compare', 'got.png', 'want.png')
    expect(poses['1'] == poses['7'] and len(set(poses.values())) == 3, 'names by content: %s' % poses)
    relight('image', name, *LIT, '-o', 'rest.png')
    run('prt', 'compare', 'rest.png', 'want.png', '--max-rmse', '0.2', status=1)


def refusals():
    for words, status, text in ((['bar', 'bar.gltf', '--animation', 'bond'], 2, 'did you mean bend?'),
                                (['bar', 'bar.gltf'], 2, '--animation is missing'),
                                (['bar', '--animation', 'bend'], 2, 'FILE is missing'),
                                (['bar', 'grow.gltf', '--animation', 'grow'], 2, 'is it another model?'),
                                (['bar', 'plain.gltf', '--animation', 'x'], 2, 'has no animations'),
                                (['bar', 'bad.gltf', '--animation', 'bend'], 1, 'names joint 1 of 1'),
                                (['bar', 'no.gltf', '--animation', 'bend'], 1, 'no.gltf')):
        said = relight('pose', *words, status=status)
        expect(text in said, '%s: %s' % (' '.join(words), said))


def main():
    os.chdir(tempfile.mkdtemp(prefix='relight-animation-'))
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
    with open('log', 'w', encoding='utf-8') as log:
        daemon = subprocess.Popen([os.path.join(BIN, 'relightd'), '--data', 'data', '--listen', 'unix:socket'],
                                  stdout=log, stderr=log)
    try:
        for _ in range(600):
            if os.path.exists('socket'):
                break
            time.sleep(0.1)
        pictures('bar.gltf', 'bar')
        pictures('beside.gltf', 'beside')
        refusals()
        expect(not [f for f in os.listdir('data/work') if f.startswith('pose')], 'a folder is left behind')
    finally:
        daemon.terminate()
        daemon.wait(60)
    return failed


if __name__ == '__main__':
    sys.exit(main() > 0)
