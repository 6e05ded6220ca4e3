#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Images of a textured model from GEOMETRY: raw texels and PNG files are the same numbers. Images in files beside a
.gltf are uploaded with it.

   tests/service/textures_daemon.py PATH/TO/bin PATH/TO/python"""
import hashlib
import json
import os
import struct
import sys
import zlib

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
sys.path.insert(0, sys.argv[2])
import relight as package  # noqa: E402
from programs import daemon, expect, main, prt, relight, same  # noqa: E402
from relight.messages import message  # noqa: E402
from textured_ball import glb, png  # noqa: E402

WIDTH, HEIGHT = 33, 20


def paeth(left, up, corner):
    guess = left + up - corner
    return min((abs(guess - left), 0, left), (abs(guess - up), 1, up), (abs(guess - corner), 2, corner))[2]


def decoded(file):
    """Width, height and RGBA bytes of a PNG file (RFC 2083)."""
    at, data, size = 8, b'', (0, 0)
    expect(file[:8] == b'\x89PNG\r\n\x1a\n', 'no PNG file')
    while at < len(file):
        n, kind = struct.unpack('>I4s', file[at:at + 8])
        body = file[at + 8:at + 8 + n]
        expect(struct.unpack('>I', file[at + 8 + n:at + 12 + n])[0] == zlib.crc32(kind + body), 'a chunk is damaged')
        if kind == b'IHDR':
            size = struct.unpack('>II', body[:8])
            expect(body[8:] == b'\x08\x06\0\0\0', 'the file is no RGBA of 8 bits')
        data += body if kind == b'IDAT' else b''
        at += 12 + n
    rows, n, out, up = zlib.decompress(data), 4 * size[0], b'', bytes(4 * size[0])
    for y in range(size[1]):
        kind, row = rows[y * (n + 1)], bytearray(rows[y * (n + 1) + 1:(y + 1) * (n + 1)])
        for i in range(n):
            left, corner = (row[i - 4], up[i - 4]) if i >= 4 else (0, 0)
            guess = [0, left, up[i], (left + up[i]) // 2, paeth(left, up[i], corner)][kind]
            row[i] = (row[i] + guess) & 255
        out, up = out + row, row
    return size, out


def check():
    # no row is like its neighbour, so that a wrong row or filter is seen
    rows = [[((x * 7 + y * y * 3) % 256, (x * y * 5) % 256, (255 - x * 6 + y) % 256) for x in range(WIDTH)]
            for y in range(HEIGHT)]
    glb('t.glb', [png(WIDTH, HEIGHT, rows)], {'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}}},
        sampler={'wrapS': 33071, 'wrapT': 33648})
    with daemon('--data', 'data', '--models', '.'):
        relight('load', 't.glb', '--name', 't', '--mm-per-unit', '1000', '--material', 'marble', '--preview')
        with package.Client('unix:socket') as client:
            answer = client._call('GEOMETRY', message('GeometryRequest', model='t', textures=True)).message
            listed, used = answer.images, answer.surfaces[0].base_map
            expect(len(listed) == 1, '%d images' % len(listed))
            expect((used.wrap_u, used.wrap_v) == (1, 2), 'wrapping of u %d, of v %d' % (used.wrap_u, used.wrap_v))
            ask = {'model': 't', 'image': listed[0].hash}
            raw = client._call('GEOMETRY', message('GeometryRequest', **ask))
            for again in range(2):  # the second answer is from the cache
                packed = client._call('GEOMETRY', message('GeometryRequest', png=True, **ask))
            image, payload = packed.message.images[0], bytes(packed.payload)
            expect(len(raw.payload) == raw.message.images[0].bytes == image.bytes, 'sizes of the raw texels')
            expect(not raw.message.images[0].png_bytes, 'raw texels are said to be files')
            expect(sum(image.png_bytes) == len(payload), 'sizes of the files')
            at, texels, sizes = 0, b'', []
            for n in image.png_bytes:
                size, level = decoded(payload[at:at + n])
                sizes.append(size)
                texels += level
                at += n
            expect(sizes == [(33, 20), (16, 10), (8, 5), (4, 2), (2, 1), (1, 1)], 'levels %s' % sizes)
            expect(texels == bytes(raw.payload), 'the files have other texels')
            first = b''.join(bytes((*p, 255)) for p in rows[0])
            expect(texels[:len(first)] == first, "the first row is not the model's")
            try:
                client._call('GEOMETRY', message('GeometryRequest', model='t', image='0' * 32, png=True))
                expect(False, 'an image that is not there was sent')
            except package.RelightError as error:
                expect(error.code == 'NOT_FOUND', 'the error is %s' % error.code)


def split(path, folder, picture, *more):
    """The GLB as folder/t.gltf: its buffer and its first image are files, the latter of the URI `picture`."""
    with open(path, 'rb') as f:
        whole = f.read()
    n = struct.unpack('<I', whole[12:16])[0]
    doc, data = json.loads(whole[20:20 + n]), whole[28 + n:]
    view = doc['bufferViews'][doc['images'][0].pop('bufferView')]
    doc['images'][0].update({'uri': picture})
    doc['images'] += [{'uri': uri} for uri in more]
    doc['buffers'][0].update({'uri': './its%20shape.bin'})
    os.makedirs(folder + '/maps', exist_ok=True)
    for name, part in (('its shape.bin', data), ('t.gltf', json.dumps(doc).encode()),
                       ('maps/skin & all.png', data[view['byteOffset']:view['byteOffset'] + view['byteLength']])):
        with open(folder + '/' + name, 'wb') as f:
            f.write(part)


def images_of(client, name):
    return [i.hash for i in client._call('GEOMETRY', message('GeometryRequest', model=name, textures=True)).message.images]


def uploads_images():
    """Images come with a .gltf, but none from elsewhere, and one that is missing is a warning."""
    glb('t.glb', [png(4, 4, [[(200, 20, 20)] * 4] * 4)], {'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}}})
    with open('secret.png', 'wb') as f:
        f.write(png(3, 3, [[(1, 2, 3)] * 3] * 3))
    split('t.glb', 'model', 'maps/skin%20%26%20all.png', 'maps/skin & all.png', 'DATA:image/png;base64,AAAA',
          '../secret.png', '%2e%2e/secret.png', os.path.abspath('secret.png'), 'link.png', 'http://host/a.png',
          'missing.png', 'maps', 'maps//skin & all.png', 'sibling.png')
    os.symlink('../secret.png', 'model/link.png')
    os.mkdir('models')  # whose name begins with that of the model's folder
    os.link('secret.png', 'models/secret.png')
    os.symlink('../models/secret.png', 'model/sibling.png')
    split('t.glb', 'bare', '../secret.png')
    own = ['--mm-per-unit', '1000', '--material', 'marble', '--preview']
    picture = ['--env', 'constant', '--size', '64x64', '--engine', 'tangent']
    with daemon('--data', 'data2'), package.Client('unix:socket') as client:
        for name, file in (('whole', 't.glb'), ('parts', 'model/t.gltf'), ('bare', 'bare/t.gltf')):
            said = relight('load', file, '--name', name, *own).said
            expect(('../secret.png' in said) == (name == 'bare'), 'warnings of %s: %s' % (name, said))
            relight('image', name, *picture, '-o', name + '.exr')
        expect(images_of(client, 'whole') == images_of(client, 'parts') != [], 'the image did not come')
        before = client.info('parts').id
        model = client.load('model/t.gltf', name='parts', mm_per_unit=1000, material='marble', preview=True)
        expect(model == before, 'the files of client/python differ')
        expect(images_of(client, 'bare') == [], 'an image from elsewhere came')
        same('parts.exr', 'whole.exr', .01)
        prt('compare', 'bare.exr', 'whole.exr', '--max-rmse', '.1', status=1)
        with open('secret.png', 'rb') as f:
            secret = f.read()
        state = client._call('PUT_BLOB', message('PutBlobRequest', hash=hashlib.sha256(secret).hexdigest(),
                                                 size=len(secret))).message
        expect(not state.complete and not state.received, 'a file from elsewhere was sent')


def upside_down():
    """flip_v of each client and of the bake: the picture of the file whose images are the right way up."""
    rows = [[(16 * y, 255 - 16 * y, 16 * x) for x in range(16)] for y in range(16)]
    for name, image in (('up.glb', rows), ('down.glb', rows[::-1])):
        glb(name, [png(16, 16, image)], {'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}}})
    scale = ['--mm-per-unit', '1000', '--material', 'marble']
    picture = ['--env', 'constant', '--size', '64x64']
    fast = ['--engine', 'tangent', '--scattering', 'dipole']
    prt('image', 'up.glb', *scale, *fast, *picture, '-o', 'up.exr')
    prt('image', 'down.glb', *scale, *fast, *picture, '-o', 'down.exr')
    prt('image', 'down.glb', '--flip-v', *scale, *fast, *picture, '-o', 'flipped.exr')
    same('flipped.exr', 'up.exr', 1e-3)
    prt('compare', 'down.exr', 'up.exr', '--max-rmse', '.1', status=1)
    with daemon('--data', 'data4'), package.Client('unix:socket') as client:
        for name, options in (('up', []), ('down', ['--flip-v'])):
            relight('load', name + '.glb', '--name', name, *options, *scale, '--preview')
            relight('image', name, *picture, '--engine', 'tangent', '-o', 'there-%s.exr' % name)
        same('there-down.exr', 'there-up.exr', 1e-3)
        for name, flip in (('up', False), ('down', True)):
            model = client.load(name + '.glb', name=name, flip_v=flip, mm_per_unit=1000, material='marble', draft=False,
                                samples=1000, cube=16, no_single=True)
            relight('image', model, *picture, '-o', 'baked-%s.exr' % name)
        same('baked-down.exr', 'baked-up.exr', 1e-3)
        prt('compare', 'baked-down.exr', 'down.exr', '--max-rmse', '.1', status=1)


OBJ = """mtllib none.mtl
mtllib its materials.mtl\r
mtllib its.mtl\tcloth.mtl
v 0 0 1\nv 1 0 0\nv 0 1 0\nv -1 0 0\nv 0 -1 0\nv 0 0 -1
vt 0 0\nvt 1 0\nvt 1 1
usemtl skin
""" + ''.join('f 1/1 %d/2 %d/3\nf 6/1 %d/2 %d/3\n' % (a, b, b, a) for a, b in ((2, 3), (3, 4), (4, 5), (5, 2)))
OBJ += 'v 0 0 2\nv 1 0 2\nv 0 1 2\nusemtl cloth\nf 7/1 8/2 9/3\n'
MTL = """newmtl skin
map_Kd -s 1 1 1 -clamp on maps\\skin & all.png
  map_Pr\t../secret.png
norm link.png
map_Ke missing.png
"""


def uploads_libraries():
    """An .obj comes with its material library and that one's images, but none from elsewhere."""
    os.makedirs('obj/maps', exist_ok=True)
    for name, part in (('o.obj', OBJ.encode()), ('its materials.mtl', MTL.encode()),
                       ('its.mtl', b'newmtl other\n'), ('cloth.mtl', b'newmtl cloth\nmap_Kd cloth.png\n'),
                       ('cloth.png', png(2, 2, [[(20, 200, 20)] * 2] * 2)),
                       ('maps/skin & all.png', png(4, 4, [[(200, 20, 20)] * 4] * 4))):
        with open('obj/' + name, 'wb') as f:
            f.write(part)
    with open('hidden.png', 'wb') as f:
        f.write(png(3, 3, [[(3, 2, 1)] * 3] * 3))
    os.symlink('../hidden.png', 'obj/link.png')
    own = ['--mm-per-unit', '1000', '--material', 'marble', '--preview']
    light = ['--env', 'constant', '--size', '64x64']
    prt('image', 'obj/o.obj', '--mm-per-unit', '1000', '--material', 'marble', '--engine', 'tangent', *light,
        '-o', 'here.exr')
    with daemon('--data', 'data3'), package.Client('unix:socket') as client:
        relight('load', 'obj/o.obj', '--name', 'obj', *own)
        relight('image', 'obj', '--engine', 'tangent', *light, '-o', 'there.exr')
        expect(len(images_of(client, 'obj')) == 2, 'images of the .obj: %s' % images_of(client, 'obj'))
        same('there.exr', 'here.exr', .01)
        before = client.info('obj').id
        model = client.load('obj/o.obj', name='obj', mm_per_unit=1000, material='marble', preview=True)
        expect(model == before, 'the files of client/python differ')
        for name in ('secret.png', 'hidden.png'):
            with open(name, 'rb') as f:
                secret = f.read()
            state = client._call('PUT_BLOB', message('PutBlobRequest', hash=hashlib.sha256(secret).hexdigest(),
                                                     size=len(secret))).message
            expect(not state.complete and not state.received, '%s was sent' % name)


main(check, uploads_images, upside_down, uploads_libraries)
