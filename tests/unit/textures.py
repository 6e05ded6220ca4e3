#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Textures through the prt program: pictures of a textured model by every engine, baked and not.

   tests/unit/textures.py PATH/TO/prt

A constant texture multiplies light after scattering by its colour, whatever its split, in each
engine; a normal map turns highlights; an image that lies about its size ends in a warning."""
import json
import math

from programs import expect, main, prt
from textured_ball import ball, flat, glb, png


def image(source, out, *options):
    model = [] if source.endswith('.prt') else ['--material', 'marble', '--mm-per-unit', '1000']
    return prt('image', source, *model, '--env', 'constant:1,1,1', '--size', '64x48', '--background',
               'none', '-o', out, *options)


def rmse(a, b):
    run = prt('compare', a, b, '--json')
    return json.loads(run.stdout)['rmse'] if run.stdout.startswith('{') else float('nan')


def check():
    # sRGB 188 is 0.5029 of linear light: pictures are compared at an exposure of log2 of it
    half, stop = 188, math.log2(((188 / 255 + .055) / 1.055) ** 2.4)
    base = {'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}}}
    glb('plain.glb', [flat((255, 255, 255))], base)
    glb('grey.glb', [flat((half,) * 3)], base)
    dim = 'constant:' + ','.join(['%.6f' % 2 ** stop] * 3)
    for engine in ('tangent', 'texture', 'splat', 'hybrid', 'reference'):
        few = ['--samples', '4000' if engine == 'reference' else '64'] + \
            (['--rays', '256', '--single-points', '16'] if engine == 'reference' else [])
        term = ['--engine', engine, '--scattering', 'dipole', '--term', 'multiple', *few]
        image('plain.glb', 'want.exr', *term, '--env', dim)
        for split in ('0', '0.5', '1'):
            image('grey.glb', 'got.exr', *term, '--texture-split', split)
            error = rmse('got.exr', 'want.exr')
            expect(error < 0.01, '%s, split %s: a constant texture is off by %g' % (engine, split, error))
        image('grey.glb', 'bare.exr', *term, '--no-textures', '--env', dim)
        expect(rmse('bare.exr', 'want.exr') < 1e-3, engine + ': --no-textures is not the plain model')

    # baked: the .prt carries the textures, and its picture is the reference's
    prt('bake', 'grey.glb', '--material', 'marble', '--mm-per-unit', '1000', '--samples', '2000', '--cube',
        '16', '--no-single', '--texture-split', '0.5', '-o', 'grey.prt')
    prt('bake', 'plain.glb', '--material', 'marble', '--mm-per-unit', '1000', '--samples', '2000', '--cube',
        '16', '--no-single', '-o', 'plain.prt')
    image('grey.prt', 'got.exr', '--term', 'multiple')
    image('plain.prt', 'want.exr', '--term', 'multiple', '--env', dim)
    expect(rmse('got.exr', 'want.exr') < 0.02, 'a baked texture is off by %g' % rmse('got.exr', 'want.exr'))
    # an engine that needs no bake leaves all of it out, as of a model
    for name in ('grey', 'plain'):
        image(name + '.prt', name + '-bare.exr', '--term', 'multiple', '--engine', 'tangent', '--scattering', 'dipole',
              '--samples', '64', '--no-textures')
    expect(rmse('grey-bare.exr', 'plain-bare.exr') < 1e-3, 'a texture shows through --no-textures: %g' %
           rmse('grey-bare.exr', 'plain-bare.exr'))
    run = prt('image', 'grey.prt', '--env', 'constant', '--texture-split', '0.3', '-o', 'x.exr', status=2)
    expect('bake again' in run.stderr, 'the error of --texture-split for a .prt: ' + run.stderr)

    # an opaque receiver is textured, too
    glb('two.glb', [flat((255, 255, 255))], base, opaque=True)
    glb('twogrey.glb', [flat((half,) * 3)], base, opaque=True)
    for name, out, env in (('two.glb', 'want.exr', dim), ('twogrey.glb', 'got.exr', 'constant')):
        image(name, out, '--opaque', 'stone', '--engine', 'tangent', '--scattering', 'dipole', '--term', 'multiple', '--env', env)
    expect(rmse('got.exr', 'want.exr') < 0.01, 'an opaque texture is off by %g' % rmse('got.exr', 'want.exr'))

    # a normal map turns highlights; a level one (128,128,255 is 0.4 % off level) does not
    bump = {'normalTexture': {'index': 0}, 'pbrMetallicRoughness': {'roughnessFactor': .3}}
    glb('level.glb', [flat((128, 128, 255))], bump)
    glb('waves.glb', [png(8, 8, [[(128 + 90 * (x % 2 * 2 - 1), 128, 220) for x in range(8)]] * 8)], bump)
    with open('white.png', 'wb') as f:
        f.write(flat((255, 255, 255)))
    side = ['--engine', 'tangent', '--scattering', 'dipole', '--samples', '64']
    for name in ('plain', 'level', 'waves'):
        image(name + '.glb', name + '.exr', *side)
    expect(rmse('level.exr', 'plain.exr') < 0.01, 'a level map changes the picture by %g' %
           rmse('level.exr', 'plain.exr'))
    expect(rmse('waves.exr', 'plain.exr') > 0.01, 'a bumpy map changes the picture by %g alone' %
           rmse('waves.exr', 'plain.exr'))

    # maps that are given replace the file's: its base colour, blurred or not, and its normals
    over = [*side, '--term', 'multiple', '--albedo-map', 'white.png']
    image('plain.glb', 'plain-white.exr', *over)
    image('grey.glb', 'grey-white.exr', *over, '--texture-split', '1')
    expect(rmse('grey-white.exr', 'plain-white.exr') < 1e-3, 'a texture shows through --albedo-map: %g' %
           rmse('grey-white.exr', 'plain-white.exr'))
    for name in ('plain', 'waves'):
        image(name + '.glb', name + '-bump.exr', *side, '--bump-map', 'white.png')
    expect(rmse('waves-bump.exr', 'plain-bump.exr') < 1e-3, 'normals of the file show through --bump-map: %g' %
           rmse('waves-bump.exr', 'plain-bump.exr'))

    # OBJ: the library's image, by corners at the seam; the same ball as the glTF's
    at, uv, tri = ball()
    with open('ball.obj', 'w') as f:
        f.write('mtllib ball.mtl\nusemtl paint\n')
        ids, ring = {}, {}
        for i, p in enumerate(at):  # one vertex at the seam and the poles, two texture coordinates
            key = tuple(round(x, 5) + 0 for x in p)
            if key not in ids:
                ids[key] = len(ids) + 1
                f.write('v %.7f %.7f %.7f\n' % p)
            ring[i] = ids[key]
        for u, v in uv:
            f.write('vt %.7f %.7f\n' % (u, 1 - v))
        for t in tri:
            f.write('f ' + ' '.join('%d/%d' % (ring[i], i + 1) for i in t) + '\n')
    rows = [[(40 + 25 * x, 30 * y, 200 - 20 * x) for x in range(8)] for y in range(8)]
    with open('paint.png', 'wb') as f:
        f.write(png(8, 8, rows))
    with open('ball.mtl', 'w') as f:
        f.write('newmtl other\nmap_Kd none.png\nnewmtl paint\nKd 1 1 1\nmap_Kd paint.png\n')
    glb('ball.glb', [png(8, 8, rows)], base)
    side = ['--engine', 'tangent', '--scattering', 'dipole', '--samples', '64', '--term', 'multiple']
    image('ball.glb', 'want.exr', *side)
    prt('image', 'ball.obj', '--material', 'marble', '--mm-per-unit', '10', '--env', 'constant:1,1,1', '--size',
        '64x48', '--background', 'none', '-o', 'got.exr', *side)
    expect(rmse('got.exr', 'want.exr') < 0.03, 'the OBJ differs from the glTF by %g' % rmse('got.exr', 'want.exr'))
    with open('ball.mtl', 'w') as f:
        f.write('newmtl paint\nmap_Kd ../paint.png\n')
    run = prt('info', 'ball.obj')
    expect('paint.png' in run.stderr and 'left out' in run.stderr, 'no warning: ' + run.stderr)
    side = ['--engine', 'tangent', '--scattering', 'dipole', '--samples', '64']

    # the file's own medium: the same picture as by the medium that the note prints
    volume = {'attenuationDistance': .005, 'attenuationColor': [.9, .7, .4]}
    glb('wax.glb', [], {'name': 'wax', 'pbrMetallicRoughness': {'baseColorFactor': [.8, .7, .6, 1],
                                                                'roughnessFactor': .4},
                        'extensions': {'KHR_materials_volume': volume, 'KHR_materials_ior': {'ior': 1.4}}})
    common = ['image', 'wax.glb', '--env', 'constant', '--size', '64x48', '--engine', 'tangent', '--scattering', 'dipole',
              '--samples', '64']
    run = prt(*common, '-o', 'own.exr')
    medium = run.stderr.split("the file's own material: ")[-1].split('\n')[0]
    expect('"eta":1.4' in medium, 'the note has no medium: ' + run.stderr)
    prt(*common, '--material', medium, '-o', 'named.exr')
    expect(rmse('own.exr', 'named.exr') < 1e-4, 'the note is not the medium of the picture')
    run = prt('image', 'plain.glb', '--env', 'constant', '-o', 'x.exr', status=2)
    expect('needs --material' in run.stderr, 'no error without a medium: ' + run.stderr)

    # an image that lies about its size, one too large, one cut off: warnings that name it
    for lie in ((60000, 60000), (16384, 16384), (4, 400)):
        glb('lie.glb', [png(4, 4, [[(1, 2, 3)] * 4] * 4, lie)], base)
        run = image('lie.glb', 'lie.exr', *side)
        expect('picture0' in run.stderr and 'left out' in run.stderr, 'no warning for %s: %s' % (lie, run.stderr))
        expect(rmse('lie.exr', 'plain.exr') < 1e-3, 'an image left out changes the picture')


main(check)
