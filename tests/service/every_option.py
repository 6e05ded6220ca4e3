#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Every option of a picture and of colours reaches the answer, whatever the daemon answered before:
each answer differs from the one without the option and from all others, and asked again in another
order, with everything in the daemon's cache, it has the same bytes. A map is of its medium.

   tests/service/every_option.py BIN"""
import os
import struct
import sys
import zlib

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'unit'))
from programs import daemon, expect, main, prt, relight, run  # noqa: E402
from textured_ball import flat, glb, png  # noqa: E402

SIZE = ['--size', '48x40']
# (name, options): of a preview that the tangent engine draws, with maps
PREVIEW = [
    ('nothing', []),
    ('engine splat', ['--engine', 'splat']),
    ('engine texture', ['--engine', 'texture']),
    ('engine hybrid', ['--engine', 'hybrid']),
    ('albedo map', ['--albedo-map', 'stripes.png']),
    ('another albedo map', ['--albedo-map', 'grey.png']),
    ('normal map', ['--normal-map', 'tilt.png']),
    ('bump map', ['--bump-map', 'stripes.png']),
    ('bump height', ['--bump-map', 'stripes.png', '--bump-mm', '1']),
    ('another bump height', ['--bump-map', 'stripes.png', '--bump-mm', '1.25']),
    ('light', ['--env', 'other.hdr']),
    ('rotation', ['--rotate', '30']),
    ('further rotation', ['--rotate', '31']),
    ('gain', ['--gain', '2']),
    ('coloured gain', ['--gain', '2,1,2']),
    ('material', ['--material', 'skin1']),
    ('material in numbers', ['--material', 'green.json']),
    ('another roughness', ['--material', 'rough.json']),
]
# of a picture alone: no colour of a vertex changes
SHADE = [
    ('size', ['--size', '48x41']),
    ('orbit', ['--orbit', '20,0']),
    ('zoom', ['--orbit', '0,0,1.5']),
    ('camera', ['--camera', '0,0,0.06:0,0,0:0,1,0:30']),
    ('angle of the camera', ['--camera', '0,0,0.06:0,0,0:0,1,0:31']),
    ('exposure', ['--exposure', '0.5']),
    ('tone reinhard', ['--tone', 'reinhard']),
    ('tone none', ['--tone', 'none']),
    ('samples of a pixel', ['--samples-per-pixel', '1']),
    ('background', ['--background', '0.2,0.3,0.4']),
    ('no background', ['--background', 'transparent']),
    ('no specular', ['--no-specular']),
    ('floor', ['--floor']),
]
# of a baked model; the eyes at the end are of colours alone
BAKED = [
    ('nothing', []),
    ('light', ['--env', 'other.hdr']),
    ('rotation', ['--rotate', '30']),
    ('gain', ['--gain', '2']),
    ('coloured gain', ['--gain', '1,2,1']),
    ('material', ['--material', 'skin1']),
    ('material in numbers', ['--material', 'green.json']),
    ('term irradiance', ['--term', 'irradiance']),
    ('term multiple', ['--term', 'multiple']),
    ('term single', ['--term', 'single']),
    ('eye', ['--eye', '0,0,0.06']),
    ('another eye', ['--eye', '0,0.01,0.06']),
]


def hdr(path, of):
    """A lat-long of 16 x 8 texels of 2^e, by (row, column)."""
    with open(path, 'wb') as f:
        f.write(b'#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n')
        f.write(b''.join(bytes((*of(y, x), 129)) for y in range(8) for x in range(16)))


def prepare():
    hdr('sky.hdr', lambda y, x: (240, 30 + 20 * y, 10 + 12 * x) if x < 6 else (9, 12, 15))
    hdr('other.hdr', lambda y, x: (30, 200, 90) if y < 3 else (20, 16, 9))
    with open('stripes.png', 'wb') as f:
        f.write(png(16, 8, [[(250, 90, 60) if x // 2 % 2 else (60, 90, 200) for x in range(16)] for _ in range(8)]))
    for name, rgb in (('grey.png', (120, 120, 120)), ('tilt.png', (190, 128, 220))):
        with open(name, 'wb') as f:
            f.write(flat(rgb))
    for name, roughness in (('green.json', 0.3), ('rough.json', 0.5)):
        with open(name, 'w', encoding='utf-8') as f:
            f.write('{"name":"own","sigma_s_prime":[1,2,1],"sigma_a":[0.1,0.01,0.1],"g":0,"eta":1.3,'
                    '"roughness":%g}' % roughness)
    os.mkdir('models')


def answer(command, model, options, ending):
    words = options if '--env' in options else ['--env', 'sky.hdr', *options]
    words = words if command == 'colors' or '--size' in words else [*SIZE, *words]
    path = 'answer.' + ending
    relight(command, model, *words, '-o', path)
    with open(path, 'rb') as f:
        data = f.read()
    os.remove(path)
    return data


def each_changes(command, model, list_, ending, more=()):
    """Answers in the list's order differ; backwards, from the caches, they are the same."""
    seen = {}
    for name, options in list_:
        data = answer(command, model, [*more, *options], ending)
        for other, bytes_ in seen.items():
            expect(data != bytes_, '%s %s: "%s" answers as "%s" does' % (command, model, name, other))
        seen[name] = data
    for name, options in reversed(list_):
        expect(answer(command, model, [*more, *options], ending) == seen[name],
               '%s %s: "%s" answers otherwise the second time' % (command, model, name))
    print('%d answers to %s %s' % (2 * len(seen), command, model))


def again(name, to):
    """The same picture in a file with other bytes: with a comment before its last chunk."""
    with open(name, 'rb') as f:
        data = f.read()
    comment = b'tEXtComment\0again'
    with open(to, 'wb') as f:
        f.write(data[:-12] + struct.pack('>I', len(comment) - 4) + comment
                + struct.pack('>I', zlib.crc32(comment)) + data[-12:])


def maps_are_of_their_medium():
    """An albedo map is of the medium it is used with, also where it was used with another before."""
    again('stripes.png', 'again.png')
    first, second = ([*('--engine', 'tangent', '--albedo-map'), name, '--material', 'skin1']
                     for name in ('again.png', 'stripes.png'))
    expect(answer('image', 'draft', first, 'png') == answer('image', 'draft', second, 'png'),
           'an albedo map is used with the medium before')


def turned_lights():
    """A light turned by a quarter is that of the turned image: background, reflection and body."""
    def sky(y, x):
        return (240, 30 + 20 * y, 10 + 12 * x) if x < 6 else (9, 12, 15)
    hdr('turned.hdr', lambda y, x: sky(y, (x + 4) % 16))
    for model, orbit in (('draft', '20,0'), ('draft', '180,0'), ('free', '20,0'), ('free', '180,0')):
        # An engine of its own choice samples by the machine's load, each picture otherwise.
        engine = ['--engine', 'tangent'] if model == 'draft' else []
        for name, options in (('a', ['--env', 'sky.hdr', '--rotate', '90']), ('b', ['--env', 'turned.hdr'])):
            with open(name + '.png', 'wb') as f:
                f.write(answer('image', model, ['--orbit', orbit, *engine, *options], 'png'))
        print(run(sys.executable, os.path.join(HERE, 'picture_difference.py'), 'a.png', 'b.png', '2').said.strip())


def own_light():
    """A polynomial model keeps the light of its bake: no --env, and other media by edit."""
    answers = []
    for arguments in (['colors', 'fixed'], ['edit', 'fixed', '--material', 'skin1']):
        relight(*arguments, '-o', 'fixed.npy')
        with open('fixed.npy', 'rb') as f:
            answers.append(f.read())
    relight('image', 'fixed', '-o', 'fixed.png')
    expect(answers[0] != answers[1], 'the material of a polynomial model changes nothing')
    expect('no lights' in relight('image', 'fixed', '--env', 'constant', '-o', 'fixed.png', status=2).said,
           'a polynomial model takes another light')
    expect('--env is missing' in relight('image', 'free', '-o', 'free.png', status=2).said,
           'a joint model needs a light')


def every_option():
    prepare()
    glb('draft.glb', [], {})
    glb('free.glb', [], {})
    prt('bake', 'free.glb', '--size-mm', '20', '--transport', 'joint', '--samples', '500', '--cube', '16',
        '-o', 'models/free.prt')
    prt('bake', 'free.glb', '--size-mm', '20', '--transport', 'polynomial', '--env', 'constant', '--samples', '500',
        '--cube', '16', '-o', 'models/fixed.prt')
    with daemon('--models', 'models', '--data', 'data', '--preview-walks=no'):  # they come when they are ready
        relight('load', 'draft.glb', '--size-mm', '20', '--material', 'marble', '--preview')
        each_changes('image', 'draft', PREVIEW + SHADE, 'png', ['--engine', 'tangent'])
        maps_are_of_their_medium()
        turned_lights()
        each_changes('colors', 'free', BAKED, 'npy')
        each_changes('image', 'free', BAKED[:-2] + SHADE, 'png')
        own_light()


main(every_option)
