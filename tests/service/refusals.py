#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A request with one fault is refused for that fault: its code, its words, and where a number is out of range the
parameter with its limits. One row a fault.

   tests/service/refusals.py PATH/TO/bin PATH/TO/python"""
import json
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
sys.path.insert(0, sys.argv[2])
import relight as package  # noqa: E402
from programs import daemon, expect, main, relight  # noqa: E402
from relight import connection  # noqa: E402
from relight.messages import message  # noqa: E402

# Types that the package does not send.
for number, kind, name in ((23, 'TOKEN_REVOKE', 'TokenRevoke'), (20, 'SUBSCRIBE', 'Subscribe'), (26, 'PUT_POSE', 'PutPose'), (28, 'ROOM_CREATE', 'RoomCreate'),
                           (31, 'ROOM_EDIT', 'RoomEdit')):
    connection.TYPES[kind] = (number, name)
    connection.NAMES[number] = 'Event' if kind == 'SUBSCRIBE' else name + 'Answer'

LIGHT = {'env': 'constant'}
EYE, TARGET = {'x': 0, 'y': 0, 'z': 9}, {'x': 0, 'y': 0, 'z': 0}
HASH = 'a' * 64


def image(**more):
    return ('IMAGE', 'ImageRequest', {'model': 'x', 'lights': [LIGHT], **more})


def camera(**fields):
    return image(picture={'camera': fields})


def shade(**fields):
    return image(shade=fields)


def load(**more):
    return ('LOAD', 'LoadRequest', {'path': 'tetrahedron.obj', 'mm_per_unit': 1, **more})


def edit(**action):
    return ('ROOM_EDIT', 'RoomEditRequest', {'room': ROOM, 'action': action})


ROOM = BLOB = ''  # set by check()

DIPOLE = '"sigma_s_prime":[1,1,1],"sigma_a":[0.1,0.1,0.1]'
CURVE = '{"profile":"curve","radius":%s,"rd":%s}'
RGB = '[[0.1,0.1],[0.1,0.1],[0.1,0.1]]'
MATERIALS = (
    ('{%s,"g":0,"g":0}' % DIPOLE, '"g" is given twice'),
    ('{%s,"g":1}' % DIPOLE, 'g'),
    ('{%s,"g":[0,0]}' % DIPOLE, 'three numbers [r,g,b]'),
    ('{%s,"eta":0.99}' % DIPOLE, 'eta'),
    ('{%s,"name":"%s"}' % (DIPOLE, 'n' * 32), '"name" must be a text of at most 31 bytes'),
    ('{%s,"density":1}' % DIPOLE, 'density'),
    ('{"sigma_s_prime":[1,1,1]}', 'sigma_a'),
    ('{"sigma_s_prime":[0,1,1],"sigma_a":[1,1,1]}', 'sigma_s_prime'),
    ('{"sigma_s_prime":[1,1,1],"sigma_a":[1,-1,1]}', 'sigma_a'),
    ('{%s' % DIPOLE, 'JSON'),
    ('{"profile":"cubic"}', 'cubic'),
    ('{"profile":"multipole","layers":[]}', 'layers, top first'),
    (CURVE % ('[1]', '[[1],[1],[1]]'), 'a curve of 1 points, allowed range 2 to'),
    (CURVE % ('[0,1]', '[[1,1],[1,1]]'), 'three lists, red, green, blue'),
    (CURVE % ('[1,1]', RGB), 'radii ascend within'),
    (CURVE % ('[0,100001]', RGB), 'radii ascend within'),
    (CURVE % ('[0,1]', '[[0.1,0.1],[0.1,-0.1],[0.1,0.1]]'), 'R_d 1 is -0.1'),
    ('{"profile":"burley","albedo":[1.1,0.5,0.5],"mean_free_path":[1,1,1]}', 'albedo'),
    ('{"profile":"burley","albedo":[0.5,0.5,0.5],"mean_free_path":[0,1,1]}', 'mean_free_path'),
)


def rows():
    yield (*image(lights=[{'env': 'constant', 'cube_n': 16}]), 'BAD_REQUEST', 'lights[0]: expected exactly one of')
    yield (*image(lights=[LIGHT, {}]), 'BAD_REQUEST', 'lights[1]: expected exactly one of')
    yield (*image(lights=[{'cube_n': 24}]), 'OUT_OF_RANGE', 'lights[0].cube_n is 24')
    yield (*image(lights=[{'cube_n': 256}]), 'OUT_OF_RANGE', '16 to 128')
    yield (*image(lights=[{**LIGHT, 'rotate_deg': 2e6}]), 'OUT_OF_RANGE', 'lights[0].rotate_deg')
    yield (*image(lights=[LIGHT, {**LIGHT, 'gain': {'x': 1, 'y': -1, 'z': 1}}]), 'OUT_OF_RANGE', 'lights[1].gain')
    yield (*image(lights=[LIGHT] * 17), 'OUT_OF_RANGE', 'lights is 17, allowed range 1 to 16')
    yield (*image(priority=7), 'BAD_REQUEST', 'none of INTERACTIVE, STILL and BULK')
    yield (*shade(albedo_map='skin'), 'BAD_REQUEST', 'shade.albedo_map skin: not the SHA-256')
    yield (*shade(normal_map=HASH[1:]), 'BAD_REQUEST', 'shade.normal_map')
    yield (*shade(bump_map=HASH.upper()), 'BAD_REQUEST', 'shade.bump_map')
    yield (*shade(bump_mm=-1), 'OUT_OF_RANGE', 'shade.bump_mm is -1, allowed range 0 to 10000 mm')
    yield (*shade(bump_mm=10001), 'OUT_OF_RANGE', 'shade.bump_mm')
    yield (*shade(materials=[{'object': 'x', 'material': '{'}]), 'OUT_OF_RANGE', 'material of "x": ')
    yield (*shade(material='granite'), 'OUT_OF_RANGE', 'granite')
    for text, said in MATERIALS:
        yield (*shade(material=text), 'OUT_OF_RANGE', said)
    yield (*shade(variant='v' * 64), 'OUT_OF_RANGE', 'more than 63 bytes')
    yield (*camera(name='a', orbit={}), 'BAD_REQUEST', 'set eye and target, or name, or orbit')
    yield (*camera(name='a', eye=EYE), 'BAD_REQUEST', 'set eye and target, or name, or orbit')
    yield (*camera(name='c' * 64), 'OUT_OF_RANGE', 'camera.name has more than 63 bytes')
    yield (*camera(orbit={'elevation_deg': 91}), 'OUT_OF_RANGE', 'the elevation in [-90, 90] degrees')
    yield (*camera(orbit={'zoom': 0.09}), 'OUT_OF_RANGE', 'the zoom in [0.1, 100]')
    yield (*camera(eye=EYE), 'BAD_REQUEST', 'eye or target is missing')
    yield (*camera(target=TARGET), 'BAD_REQUEST', 'eye or target is missing')
    yield (*camera(eye=EYE, target=TARGET, fovy_deg=170), 'OUT_OF_RANGE', 'fovy_deg is 170')
    yield (*camera(eye=EYE, target=TARGET, up=EYE), 'OUT_OF_RANGE', 'lie on one line')
    yield (*camera(eye=EYE, target=EYE), 'OUT_OF_RANGE', 'lie on one line')
    yield (*image(picture={'width': 4097}), 'OUT_OF_RANGE', '4096')
    yield (*image(picture={'quality': 101}), 'OUT_OF_RANGE', 'quality is 101, allowed range 1 to 100')
    yield (*image(picture={'samples': 3}), 'OUT_OF_RANGE', 'samples is 3')
    yield (*image(picture={'exposure_ev': 41}), 'OUT_OF_RANGE', 'exposure_ev is 41, allowed range -40 to 40 stops')
    yield (*image(picture={'format': 'IMAGE_JPEG', 'transparent': True}), 'UNSUPPORTED', 'alpha')
    yield 'COLORS', 'ColorsRequest', {'model': 'x', 'lights': [LIGHT], 'exposure_ev': -41}, 'OUT_OF_RANGE', 'exposure_ev'
    yield 'ENV', 'EnvRequest', {'env': 'constant', 'cube_n': 8}, 'OUT_OF_RANGE', 'cube_n 8 is not 16, 32, 64, 128 or 256'
    yield 'ENV', 'EnvRequest', {'env': 'constant', 'thumbnail': 33}, 'OUT_OF_RANGE', 'thumbnail'
    yield 'PUT_BLOB', 'PutBlobRequest', {'hash': HASH[1:], 'size': 1}, 'BAD_REQUEST', '64 lower-case hex digits'
    yield 'PUT_BLOB', 'PutBlobRequest', {'upload': 'x', 'size': 1}, 'BAD_REQUEST', '64 lower-case hex digits'
    yield 'SUBSCRIBE', 'SubscribeRequest', {'model': 'x'}, 'BAD_REQUEST', 'expected an id of 32 hex digits'
    yield 'SUBSCRIBE', 'SubscribeRequest', {'model': HASH[:33]}, 'BAD_REQUEST', 'expected an id of 32 hex digits'
    yield 'WATCH', 'WatchRequest', {'job': 'none'}, 'NOT_FOUND', 'none: no such job'
    yield 'SIGN', 'SignRequest', {'url': '/v1/models/x/image.jpg', 'lifetime_s': 366 * 86400 + 1}, 'OUT_OF_RANGE', 'lifetime_s'
    yield 'PUT_POSE', 'PutPoseRequest', {'model': 'x', 'animation': 'walk', 'n': 1}, 'BAD_REQUEST', 'leave n, base_pose and payload out'
    yield (*load(materials=[{'object': 'a=b', 'material': 'jade'}]), 'BAD_REQUEST', "has no '=', '{' or '/' here")
    yield (*load(materials=[{'object': 'a', 'material': 'marble'}] * 2), 'BAD_REQUEST', 'another entry gives it a material, too')
    yield (*load(materials=[{'object': 'o%d' % i, 'material': 'jade'} for i in range(65)]), 'LIMIT', 'more than 64 materials')
    yield (*load(materials=[{'object': 'a'}]), 'BAD_REQUEST', 'an object or a material is missing')
    yield (*load(bake={'transport': 'TRANSPORT_WAVELET'}), 'BAD_REQUEST', "material is missing: a preset's name or JSON text")
    yield (*load(bake={'env': '/etc/passwd'}), 'BAD_REQUEST', 'neither env:HASH nor constant[:R,G,B]')
    yield (*load(bake={'env': 'env:' + HASH}), 'NOT_FOUND', 'was not uploaded')
    yield (*load(bake={'env': 'name:studio'}), 'NOT_FOUND', 'no image of this name')
    yield (*load(size_mm=1), 'OUT_OF_RANGE', 'size_mm and mm_per_unit are both given')
    yield (*load(path='none.obj'), 'FORBIDDEN', 'no such file inside the models folder')
    yield (*load(path='../tetrahedron.obj'), 'FORBIDDEN', 'no such file inside the models folder')
    yield (*load(path='', files=[{'name': '../x.obj', 'blob': BLOB}]), 'FORBIDDEN', 'files[0]: the name is not a plain')
    yield (*load(path='', files=[{'name': 'x.obj', 'blob': HASH}]), 'NOT_FOUND', 'x.obj: its blob was not uploaded')
    yield (*load(path='', files=[{'name': 'x.obj', 'blob': BLOB}, {'name': 'x.obj/y', 'blob': BLOB}]), 'BAD_REQUEST',
           'files[1]: x.obj/y cannot be beside x.obj')
    yield (*load(files=[{'name': 'x.obj', 'blob': BLOB}]), 'BAD_REQUEST', 'path')
    yield (*edit(), 'BAD_REQUEST', 'not exactly one action')
    yield (*edit(rename={}), 'LIMIT', "a room's name has 1 to 120 bytes")
    yield (*edit(reply={'target': 999, 'text': 'a'}), 'NOT_FOUND', '999')
    # the remedy is that of the thing which is missing
    yield (*edit(reply={'target': 999, 'text': 'a'}), 'NOT_FOUND', '`relight room show`')
    yield 'ROOM_EDIT', 'RoomEditRequest', {'room': HASH[:32], 'action': {'save': {}}}, 'NOT_FOUND', '`relight room list`'
    yield 'TOKEN_REVOKE', 'TokenRevokeRequest', {'name': 'nobody'}, 'NOT_FOUND', '`relight token list`'
    for files, code, said in (
            ([{'name': 'x.obj', 'blob': BLOB}, {'name': 'y.bin', 'blob': HASH}], 'NOT_FOUND', 'files[1] y.bin: its blob was not'),
            ([{'name': '../x', 'blob': BLOB}], 'BAD_REQUEST', 'files[0] ../x: the name is not a plain')):
        yield 'PUT_POSE', 'PutPoseRequest', {'model': 'x', 'animation': 'walk', 'files': files}, code, said




def refusal(client, kind, name, fields):
    try:
        client._call(kind, message(name, **fields))
    except package.RelightError as error:
        return error
    return None


def check():
    global ROOM, BLOB
    with open('tetrahedron.obj', 'w', encoding='utf-8') as f:
        f.write('v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n')
    with daemon('--data', 'data', '--models', '.'), package.Client('unix:socket') as client:
        relight('load', 'tetrahedron.obj', '--mm-per-unit', '10', '--material', 'marble', '--preview', '--name', 'x')
        BLOB = client.upload('tetrahedron.obj')
        scene = {'model': client.info('x').id, 'lights': [LIGHT]}
        ROOM = client._call('ROOM_CREATE', message('RoomCreateRequest', name='r', scene=scene)).message.room
        for kind, name, fields, code, text in rows():
            error = refusal(client, kind, name, fields)
            what = '%s %s' % (kind, fields)
            expect(error is not None, what + ': was accepted')
            if error:
                expect(error.code == code and text in error.text + error.hint,
                       '%s: wanted %s "%s", got %s "%s"; "%s"' % (what, code, text, error.code, error.text, error.hint))
                token = 'relight token create' in error.hint
                expect(not token or 'scope' in error.text, '%s: "%s" is no matter of tokens' % (what, error.text))
                ranged = ' is ' in error.text.partition(', allowed range ')[0] and ', allowed range ' in error.text
                expect(not ranged or (error.parameter and error.minimum is not None), what + ': the range is no field')


def names_of_files():
    """An error tells of a file by its name in the model, not by the daemon's folder."""
    model = {'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0]}], 'nodes': [{'mesh': 0}],
             'meshes': [{'primitives': [{'attributes': {'POSITION': 0}}]}],
             'accessors': [{'bufferView': 0, 'componentType': 5126, 'type': 'VEC3', 'count': 3}],
             'bufferViews': [{'buffer': 0, 'byteLength': 36}], 'buffers': [{'byteLength': 36, 'uri': 'maps'}]}
    with daemon('--data', 'data2'), package.Client('unix:socket') as client:
        files = [{'name': 'm.gltf', 'blob': client.upload(json.dumps(model).encode())},
                 {'name': 'maps/x.bin', 'blob': client.upload(b'x')}]  # a folder of this name
        error = refusal(client, *load(path='', files=files, material='marble', preview=True))
        expect(error and error.text == 'maps: not a regular file', 'a folder as a buffer: %s' % (error and error.text))


main(check, names_of_files)
