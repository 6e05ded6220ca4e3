#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""--bake-queue bakes wait or run and one more is refused; a cancelled one leaves its place, waiting or
running, and the next takes it. --bakes of them run at a time. A model whose bake was cancelled has no job as a
preview.

   tests/service/bake_queue.py BIN"""
import json
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
from programs import daemon, expect, main, relight  # noqa: E402
from textured_ball import glb  # noqa: E402

PLACES = 3


def load(name, status=0):
    done = relight('load', 'ball.glb', '--size-mm', '20', '--material', 'marble', '--name', name, '--no-draft',
                   '--samples', '2000000', '--seed', str(len(name)), '--json', status=status)
    return done.said if status else json.loads(done.stdout)['job']


def number(name):
    return json.loads(relight('stats', '--json').stdout)['relightd_jobs_' + name]


def places():
    glb('ball.glb', [], {})
    with daemon('--data', 'data', '--bakes', '1', '--bake-queue', str(PLACES)):
        jobs = [load('x' * (i + 1)) for i in range(PLACES)]
        expect(number('running') == 1 and number('open') == PLACES, '%d run' % number('running'))
        for round_ in range(PLACES + 1):
            said = load('refused', status=1)
            expect("daemon's limit of %d (--bake-queue)" % PLACES in said, 'one too many: ' + said)
            relight('cancel', jobs.pop(-1))  # waits
            jobs.append(load('y' * (10 + round_)))
        for round_ in range(2):
            relight('cancel', jobs[0])  # runs
            relight('watch', jobs.pop(0), status=1)  # until it has ended
            jobs.append(load('z' * (20 + round_)))
        load('refused', status=1)
        for job in jobs[::-1]:
            relight('cancel', job)


def side_by_side():
    with daemon('--data', 'pairs', '--bakes', '2'):
        jobs = [load('x' * (i + 1)) for i in range(4)]
        for left in (4, 3):
            expect(number('running') == 2, '%d of %d run' % (number('running'), left))
            relight('cancel', jobs[0])
            relight('watch', jobs.pop(0), status=1)
        expect(number('running') == 2 and number('open') == 2, '%d of the last two run' % number('running'))
        for job in jobs:
            relight('cancel', job)


def preview_after_a_bake():
    with daemon('--data', 'preview'):
        job = load('x')
        relight('cancel', job)
        relight('watch', job, status=1)
        again = ['load', 'ball.glb', '--size-mm', '20', '--material', 'marble', '--samples', '2000000', '--seed', '1',
                 '--preview', '--wait', '--json']
        loaded = json.loads(relight(*again).stdout or '{}')
        expect(loaded.get('state') == 'preview' and 'job' not in loaded, 'a preview has a job: %s' % loaded)
        info = json.loads(relight('info', 'x', '--json').stdout)
        expect(info['state'] == 'preview' and 'job' not in info, 'a preview has a job: %s' % info)


main(places, side_by_side, preview_after_a_bake)
