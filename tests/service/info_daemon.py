#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""relight info --json about a live relightd's model says what the model's file has, and what the daemon's HTTP
says of it.

   tests/service/info_daemon.py BIN"""
import json
import os
import re
import sys
import urllib.request

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import animated  # noqa: E402
import candle  # noqa: E402
import variant_model  # noqa: E402
from programs import daemon, expect, main, relight  # noqa: E402


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
NAMES = {'vertices': 'n_vertex', 'triangles': 'n_triangle', 'objects': 'n_object', 'box_min_mm': 'box_min', 'box_max_mm': 'box_max'}


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


main(cameras, fields)
