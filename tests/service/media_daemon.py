#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A bake of several media served by a live relightd: colours, coefficients and pictures are prt's.

   tests/service/media_daemon.py BIN"""
import os
import subprocess
import sys
import tempfile
import time

BIN = os.path.abspath(sys.argv[1])
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import candle  # noqa: E402

failed = 0


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


def same(a, b, most):
    run('prt', 'compare', a, b, '--max-rmse', str(most))


def check():
    lit = ['--env', 'constant', '--rotate', '30']
    run('prt', 'colors', 'models/fixed.prt', *lit, '-o', 'want.csv')
    relight('colors', 'fixed', *lit, '-o', 'got.csv')
    same('got.csv', 'want.csv', 1e-5)
    # a factor of the exit for each block: one eta for all would be 3 % off
    relight('colors', 'fixed', *lit, '--format', 'coefficients', '-o', 'got.csv')
    same('got.csv', 'want.csv', 2e-3)
    picture = [*lit, '--size', '96x72']
    run('prt', 'image', 'models/fixed.prt', *picture, '-o', 'want.png')
    relight('image', 'fixed', *picture, '-o', 'got.png')
    same('got.png', 'want.png', 0.02)
    # image-space engines draw with the bake's media, too
    run('prt', 'image', 'models/fixed.prt', *picture, '--engine', 'texture', '-o', 'want.png')
    relight('image', 'fixed', *picture, '--engine', 'texture', '-o', 'got.png')
    same('got.png', 'want.png', 0.05)
    said = relight('colors', 'fixed', *lit, '--material', 'skin1', '-o', 'got.csv', status=2)
    expect('cannot change' in said, 'a fixed medium: ' + said)


def main():
    os.chdir(tempfile.mkdtemp(prefix='relight-media-'))
    os.mkdir('models')
    candle.write('candle.gltf')
    run('prt', 'bake', 'candle.gltf', '--samples', '1500', '--cube', '16', '--material', 'wax=marble',
        '--material', 'holder=ketchup', '-o', 'models/fixed.prt', '--quiet')
    with open('log', 'w', encoding='utf-8') as log:
        daemon = subprocess.Popen([os.path.join(BIN, 'relightd'), '--models', 'models', '--listen', 'unix:socket'],
                                  stdout=log, stderr=log)
    try:
        for _ in range(600):
            if os.path.exists('socket'):
                break
            time.sleep(0.1)
        relight('load', 'fixed.prt')
        check()
    finally:
        daemon.terminate()
        daemon.wait(60)
    return failed


if __name__ == '__main__':
    sys.exit(main() > 0)
