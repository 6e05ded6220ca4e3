#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""relight info --json about a live relightd's model says what the model's file has.

   tests/service/info_daemon.py BIN"""
import json
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import animated  # noqa: E402
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


main(cameras)
