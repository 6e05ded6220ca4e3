#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What relight says of a live relightd: its models, as their files have them and as the daemon's HTTP says, what
happened to them, and tokens.

   tests/service/info_daemon.py BIN"""
import json
import os
import re
import sys
import time
import urllib.request

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import animated  # noqa: E402
import candle  # noqa: E402
import variant_model  # noqa: E402
from programs import daemon, expect, main, prt, relight  # noqa: E402


def cameras():
    model = animated.plain()  # a ball of radius 1 about the origin
    model.data['cameras'] = [{'type': 'perspective', 'name': 'front', 'perspective': {'yfov': .6, 'znear': .1}}]
    model.data['nodes'] = [{'mesh': 0, 'children': [1]}, {'camera': 0, 'translation': [0, 0, 7]}]
    model.write('ball.gltf')
    with daemon('--data', 'data'):
        relight('load', 'ball.gltf', '--name', 'ball', '--size-mm', '20', '--material', 'skin1', '--preview')
        said = relight('info', 'ball', '--json').stdout
    found = json.loads(said)['cameras']
    expect(len(found) == 1 and found[0]['name'] == 'front', said)
    eye, target, up = (found[0][k] for k in ('eye', 'target', 'up'))
    expect(eye == [0, 0, 7] and up == [0, 1, 0], said)
    expect(target[:2] == [0, 0] and target[2] < 7, said)
    expect(abs(found[0]['fovy_deg'] - 34.37747) < 1e-3, said)


# What HTTP calls them.
NAMES = {'vertices': 'n_vertex', 'triangles': 'n_triangle', 'objects': 'n_object', 'box_min_mm': 'box_min',
         'box_max_mm': 'box_max'}


def agree(said, other, where):
    """Each field of the JSON is HTTP's."""
    if where.split('.')[-1] in ('settings', 'errors', 'material', 'media'):
        expect(said == other, '%s: %s, HTTP %s' % (where, said, other))
    elif isinstance(said, dict):
        other = {**other, **other.get('camera', {})}
        for key, value in said.items():
            there = other.get(NAMES.get(key, key))
            if there is None or (not value and there == 'default'):  # of a preview
                expect(not value, '%s.%s is no field of HTTP' % (where, key))
            else:
                agree(value, there, '%s.%s' % (where, key))
    elif isinstance(said, list):
        there = [other[k] for k in 'xyz'] if isinstance(other, dict) else other
        expect(len(said) == len(there), '%s: %s, HTTP %s' % (where, said, there))
        for i, pair in enumerate(zip(said, there)):
            agree(*pair, '%s[%d]' % (where, i))
    elif isinstance(said, float) or isinstance(other, float):
        expect(abs(said - other) <= 1e-6 * abs(other), '%s: %s, HTTP %s' % (where, said, other))
    else:
        expect(said == other, '%s: %s, HTTP %s' % (where, said, other))


def fields():
    """A pinned bake of two media whose vertices moved, a preview with variants, one with a camera."""
    candle.write('candle.gltf')
    variant_model.write('shoes.glb')
    with daemon('--data', 'other', '--http', '127.0.0.1:0'):
        relight('load', 'candle.gltf', '--name', 'candle', '--samples', '300', '--cube', '16', '--material', 'wax=skin1',
                '--material', 'ketchup', '--transport', 'wavelet', '--pin', '--wait')
        relight('geometry', 'candle', '-o', 'moved.npy')
        relight('update-vertices', 'candle', '--positions', 'moved.npy')
        relight('load', 'shoes.glb', '--name', 'shoes', '--preview')
        relight('load', 'ball.gltf', '--name', 'ball', '--size-mm', '20', '--material', 'skin1', '--preview')
        with open('log', encoding='utf-8') as log:
            at = 'http://127.0.0.1:%s/v1/models' % re.search(r'http:127\.0\.0\.1:(\d+)', log.read())[1]
        names = 'candle', 'shoes', 'ball'
        for name in names:
            with urllib.request.urlopen('%s/%s' % (at, name)) as answer:
                other = json.load(answer)
            said = json.loads(relight('info', name, '--json').stdout)
            agree(said, other, name)
            missing = set(other) - {NAMES.get(k, k) for k in said} - {'fraction', 'exit_planes', 'job'}
            expect(not missing, '%s: info has no %s' % (name, missing))
        with urllib.request.urlopen(at) as answer:
            listed = {m['name']: m for m in json.load(answer)['models']}
        said = {m['name']: m for m in json.loads(relight('models', '--json').stdout)['models']}
        expect(set(said) == set(listed) == set(names), '%s, HTTP %s' % (list(said), list(listed)))
        for name in said:
            agree(said[name], listed[name], 'models: ' + name)


def events():
    """relight events: each thing that happened once, with whose it was and how it ended."""
    prt('env', 'constant:1,1,1', '-o', 'sky.exr')
    with open('small.obj', 'w', encoding='utf-8') as f:
        f.write('v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 4\nf 3 2 4\nf 2 1 4\nf 1 2 3\n')
    with open('flat.obj', 'w', encoding='utf-8') as f:
        f.write('v 0 0 0\nv 0 0 0\nv 1 0 0\nf 1 2 3\n')
    with daemon('--data', 'third'):
        done = json.loads(relight('load', 'small.obj', '--name', 'ball', '--samples', '100', '--cube', '16', '--size-mm', '10',
                                  '--material', 'marble', '--json').stdout.split('\n')[0])
        relight('watch', done['job'])
        env = json.loads(relight('env', 'sky.exr', '--json').stdout)['env']
        failed = json.loads(relight('load', 'flat.obj', '--name', 'flat', '--size-mm', '10', '--json').stdout.split('\n')[0])
        why = relight('watch', failed['job'], status=1).said
        relight('unload', 'ball', '--forget')
        said = [json.loads(line) for line in relight('events', '--json').stdout.splitlines()]
        text = relight('events').stdout.splitlines()
    ball, flat = {'model': done['model']}, {'model': failed['model']}
    want = [{**ball, 'event': 'model added', 'name': 'ball', 'state': 'received', 'generation': 1},
            {**ball, 'event': 'model changed', 'name': 'ball', 'state': 'unloaded', 'generation': 1},
            {**ball, 'event': 'bake', 'job': done['job'], 'state': 'done', 'fraction': 1},
            {'event': 'environment added', 'env': env, 'name': 'sky.exr'},
            {**flat, 'event': 'model added', 'name': 'flat', 'state': 'received', 'generation': 1},
            {**flat, 'event': 'model changed', 'name': 'flat', 'state': 'failed', 'generation': 1},
            {**flat, 'event': 'bake', 'job': failed['job'], 'state': 'failed', 'fraction': 0},
            {**ball, 'event': 'model removed', 'name': 'ball', 'state': 'unloaded', 'generation': 1}]
    for e in said:
        expect(('failure' in e) == (e.get('state') == 'failed'), 'events: %s' % e)
        expect(e.get('failure', '') in why, 'events: %s, watch: %s' % (e, why))
    times = [e['time_us'] for e in said]
    expect(times == sorted(times), 'events: %s' % times)
    got = [{k: v for k, v in e.items() if k not in ('time_us', 'kind', 'stage', 'failure')} for e in said]
    expect(got == want, 'events: %s, not %s' % (got, want))
    expect(len(text) == len(want), 'events: %s' % text)
    for line, e in zip(text, want):
        for word in [str(v) for k, v in e.items() if k not in ('generation', 'fraction')]:
            expect(word in line or (word == e.get('name') and 'job' in e), 'events: no %s in %s' % (word, line))


def tokens():
    """relight token list: each token's rights, end and quotas are those that it was made with."""
    quotas = {'connections': 3, 'requests': 4, 'views': 5, 'memory': 6 << 20, 'output': 7 << 20, 'bakes': 8, 'uploads': 9,
              'models': 10, 'disk': 11 << 20, 'rate': 12.5}
    with daemon('--data', 'fourth'):
        options = [word for name, n in quotas.items() for word in ('--' + name, str(n))]
        before = int(time.time())
        secret = json.loads(relight('token', 'create', '--name', 'anna', '--scope', 'view,edit', '--expires', '2d', *options,
                                    '--json').stdout)
        plain = relight('token', 'create', '--name', 'bert', '--scope', 'admin').stdout.strip()
        after = int(time.time())
        said = {t['name']: t for t in json.loads(relight('token', 'list', '--json').stdout)}
        text = relight('token', 'list').stdout.splitlines()[1:]
        closed = json.loads(relight('token', 'revoke', 'anna', '--json').stdout)
        left = json.loads(relight('token', 'list', '--json').stdout)
    expect(secret['name'] == 'anna' and secret['token'] != plain, 'tokens: %s, %s' % (secret, plain))
    anna, bert = said.pop('anna'), said.pop('bert')
    expect(not said, 'tokens: %s' % said)
    expect((anna['scopes'], bert['scopes']) == (['view', 'edit'], ['admin']), 'scopes: %s, %s' % (anna, bert))
    expect((anna['quotas'], bert['quotas']) == (quotas, {}), 'quotas: %s, %s' % (anna, bert))
    for t in anna, bert:
        expect(before <= t['created_s'] <= after and t['by'] == 'uid:%d' % os.getuid(), 'who and when: %s' % t)
        expect(t['connections'] == 0, 'connections: %s' % t)
    expect(0 <= anna['expires_s'] - anna['created_s'] - 2 * 86400 <= 1 and bert['expires_s'] == 0, 'ends: %s, %s' % (anna, bert))
    expect(sorted(line.split()[0] for line in text) == ['anna', 'bert'], 'tokens: %s' % text)
    of_anna = next(line for line in text if line.startswith('anna'))
    for name, n in quotas.items():
        expect('%s=%s' % (name, n) in of_anna, 'no %s=%s in %s' % (name, n, of_anna))
    expect('view,edit' in of_anna and 'by uid:%d' % os.getuid() in of_anna, of_anna)
    expect(closed == {'connections': 0} and [t['name'] for t in left] == ['bert'], 'tokens: %s, %s' % (closed, left))


main(cameras, fields, events, tokens)
