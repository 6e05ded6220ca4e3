#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Several media served by a live relightd: colours, coefficients, pictures, views, previews and
loads by a map of materials are prt's.

   tests/service/media_daemon.py BIN FOLDER_OF_THE_PYTHON_PACKAGE"""
import json
import os
import re
import sys
import urllib.error
import urllib.parse
import urllib.request

PYTHON = os.path.abspath(sys.argv[2])
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
import candle  # noqa: E402
from programs import daemon, expect, main, prt, relight, run, same  # noqa: E402

LIT = ['--env', 'constant', '--rotate', '30']
DIPOLE = ['--engine', 'texture', '--scattering', 'dipole']
PICTURE = [*LIT, '--size', '96x72']
# of the index of the bake's wax and holder
GREEN = '{"name":"green","sigma_s_prime":[1,2,1],"sigma_a":[0.1,0.01,0.1],"g":0.2,"eta":1.5,"roughness":0.1}'
BROWN = '{"name":"brown","sigma_s_prime":[0.5,0.6,0.7],"sigma_a":[0.05,0.1,0.3],"g":0,"eta":1.5,"roughness":0.2}'
GREY = '{"name":"grey","sigma_s_prime":[3,3,3],"sigma_a":[0.2,0.2,0.2],"g":0.1,"eta":1.5,"roughness":0.3}'
# a profile is parsed by a worker
CURVE = '{"name":"curve","profile":"burley","albedo":[0.8,0.7,0.6],"mean_free_path":[1.5,1.2,1],"eta":1.3}'


def dipole(words):
    """The same options, of prt: its image-space engines scale to walks, this daemon's do not."""
    return [*words, '--scattering', 'dipole'] if '--engine' in words else words


def rows(path):
    with open(path, encoding='utf-8') as f:
        return f.read().split('\n')[1:]


def material(*entries):
    return [word for entry in entries for word in ('--material', entry)]


def one_bake():
    """A wavelet bake of two media: theirs are fixed."""
    prt('colors', 'models/fixed.prt', *LIT, '-o', 'want.csv')
    relight('colors', 'fixed', *LIT, '-o', 'got.csv')
    same('got.csv', 'want.csv', 1e-5)
    # a factor of the exit for each block: one eta for all would be 3 % off
    relight('colors', 'fixed', *LIT, '--format', 'coefficients', '-o', 'got.csv')
    same('got.csv', 'want.csv', 2e-3)
    prt('image', 'models/fixed.prt', *PICTURE, '-o', 'want.png')
    relight('image', 'fixed', *PICTURE, '-o', 'got.png')
    same('got.png', 'want.png', 0.02)
    # image-space engines draw with the bake's media, too
    prt('image', 'models/fixed.prt', *PICTURE, *DIPOLE, '-o', 'want.png')
    relight('image', 'fixed', *PICTURE, '--engine', 'texture', '-o', 'got.png')
    same('got.png', 'want.png', 0.05)
    for words in ('skin1', 'wax=skin1'):
        said = relight('colors', 'fixed', *LIT, *material(words), '-o', 'got.csv', status=2).said
        expect('cannot change; for others, bake it' in said, 'a fixed medium: ' + said)


def maps():
    """A joint bake: the daemon's answer under a map is prt's, and an edit changes one object."""
    own = None
    for entries in ((), ('wax=' + GREEN,), ('holder=skin1',), ('wax=' + GREEN, 'foot=cream'),
                    ('holder=' + CURVE, 'candle=' + GREEN), ('wax=marble', 'ketchup')):
        prt('colors', 'models/open.prt', *LIT, *material(*entries), '-o', 'want.csv')
        relight('colors', 'open', *LIT, *material(*entries), '-o', 'got.csv')
        same('got.csv', 'want.csv', 1e-6)
        got = rows('got.csv')
        own = own or got
        changed = {'candle': 0, 'foot': 1}
        for node, of in changed.items():
            part = candle.vertices(node, of)
            equal = got[part.start:part.stop] == own[part.start:part.stop]
            named = any(e.startswith(('wax=', 'candle=')) and of == 0 and 'marble' not in e or
                        e.startswith(('holder=', 'foot=')) and of == 1 for e in entries)
            expect(equal != named, '%s under %s' % (node, entries))
    relight('colors', 'open', *LIT, *material('wax=' + GREEN), '--format', 'coefficients', '-o', 'got.csv')
    prt('colors', 'models/open.prt', *LIT, *material('wax=' + GREEN), '-o', 'want.csv')
    same('got.csv', 'want.csv', 2e-3)
    # again, from the contraction with the light
    relight('colors', 'open', *LIT, *material('wax=' + GREEN), '-o', 'got.csv')
    same('got.csv', 'want.csv', 1e-3)


def pictures():
    for engine, most in (('joint', 0.01), ('texture', 0.02), ('splat', 0.02)):
        own = ['--engine', engine] if engine != 'joint' else []
        prt('image', 'models/open.prt', *PICTURE, *dipole(own), *material('wax=' + GREEN), '-o', 'want.png')
        relight('image', 'open', *PICTURE, *own, *material('wax=' + GREEN), '-o', 'got.png')
        same('got.png', 'want.png', most)
        relight('image', 'open', *PICTURE, *own, '-o', 'plain.png')
        prt('compare', 'plain.png', 'want.png', '--max-rmse', str(5 * most), status=1)


MTLX = """<?xml version="1.0"?>
<materialx version="1.38">
  <open_pbr_surface name="soft" type="surfaceshader">
    <input name="subsurface_weight" type="float" value="1"/>
    <input name="subsurface_color" type="color3" value="0.8, 0.6, 0.4"/>
    <input name="subsurface_radius" type="float" value="0.1"/>
  </open_pbr_surface>
  <open_pbr_surface name="paint" type="surfaceshader"/>
</materialx>
"""


def files():
    """Materials of other programs: the daemon converts them as prt does."""
    with open('soft.mtlx', 'w', encoding='utf-8') as f:
        f.write(MTLX)
    for word in ('wax=soft.mtlx', 'wax=soft.mtlx#soft', 'wax=soft.mtlx#so'):
        prt('colors', 'models/open.prt', *LIT, *material(word), '-o', 'want.csv')
        relight('colors', 'open', *LIT, *material(word), '-o', 'got.csv')
        same('got.csv', 'want.csv', 1e-6)
    with open('bad.mtlx', 'w', encoding='utf-8') as f:
        f.write('<?xml version="1.0"?><materialx')
    for word, text in (('soft.mtlx#paint', 'paint'), ('soft.mtlx#softer', 'did you mean soft?'), ('bad.mtlx', 'material'),
                       ('none.mtlx', 'none.mtlx')):
        said = relight('colors', 'open', *LIT, *material(word), '-o', 'no.csv',
                   status=1 if word in ('bad.mtlx', 'none.mtlx') else 2).said
        expect(text in said, '%s: %s' % (word, said))


def floors():
    """The shadow on the floor is prt's, on a background and as alpha, under baked and image-space engines."""
    for words, ending in ((['--background', '0.5,0.5,0.5'], 'png'), (['--background', 'transparent'], 'exr'),
                          (['--background', '0.5,0.5,0.5', '--engine', 'texture'], 'png')):
        prt('image', 'models/open.prt', *PICTURE, *dipole(words), '--floor', '-o', 'want.' + ending)
        relight('image', 'open', *PICTURE, *words, '--floor', '-o', 'got.' + ending)
        same('got.' + ending, 'want.' + ending, 0.02)
        relight('image', 'open', *PICTURE, *words, '-o', 'bare.' + ending)
        if ending == 'png':
            prt('compare', 'bare.png', 'want.png', '--max-rmse', '0.02', status=1)


def previews():
    """relight-preview draws each object with its own eta and roughness."""
    lit = ['--env', 'constant', '--size', '96x72']
    for entries in ((), ('wax=' + GREEN,), ('wax=' + GREEN, 'holder=skin1')):
        relight('image', 'open', *lit, *material(*entries), '-o', 'want.png')
        run('relight-preview', '-s', 'unix:socket', 'open', *lit, *material(*entries), '-o', 'got.png')
        same('got.png', 'want.png', 0.01)
    said = run('relight-preview', '-s', 'unix:socket', 'open', *lit, *material('wux=marble'), '-o', 'no.png', status=2).said
    expect('did you mean wax?' in said, said)


def ask(path, **query):
    """Status and body of a GET of the daemon's HTTP."""
    with open('log', encoding='utf-8') as log:
        port = re.search(r'http:127\.0\.0\.1:(\d+)', log.read())[1]
    url = 'http://127.0.0.1:%s%s?%s' % (port, path, urllib.parse.urlencode(query))
    try:
        with urllib.request.urlopen(url, timeout=120) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as refused:
        return refused.code, refused.read()


def web():
    """material.OBJECT of a query is an entry of the map."""
    relight('colors', 'open', *LIT, *material('wax=' + GREEN, 'skin1'), '-o', 'want.csv')
    status, csv = ask('/v1/models/open/colors.csv', env='constant', rotate=30, material='skin1',
                      **{'material.wax': GREEN})
    with open('got.csv', 'wb') as f:
        f.write(csv)
    expect(status == 200, 'a query with a map: %d %s' % (status, csv[:200]))
    same('got.csv', 'want.csv', 1e-6)
    for name, value, text in (('material.wux', 'marble', b'did you mean wax?'), ('material.', 'marble', b'missing'),
                              ('material.wax', '', b'missing')):
        status, said = ask('/v1/models/open/image.png', env='constant', size='64x48', **{name: value})
        expect(status in (400, 422) and text in said, '%s: %d %s' % (name, status, said[:300]))


def refusals():
    for words, status, text in (
            (('wux=skin1',), 2, 'did you mean wax?'),
            (('wick=skin1',), 2, 'it is opaque'),
            (('wax=marble', 'wax=' + GREEN), 2, 'another entry'),
            (('candle=marble', 'wax=' + GREEN), 2, 'another entry'),
            (('wax=skin9',), 2, 'did you mean skin1?'),
            (('wax=' + GREEN.replace('1.5', '9'),), 2, 'eta is 9'),
            (('marble', 'ketchup'), 2, 'two --material'),
            (('x' * 300 + '=marble',), 2, 'no translucent material'),
            (tuple('wax%d=marble' % i for i in range(65)), 2, 'at most 64')):
        said = relight('colors', 'open', *LIT, *material(*words), '-o', 'no.csv', status=status).said
        expect(text in said and len(said.strip().split('\n')) <= 3, '%s: %s' % (words[0][:30], said))
    expect(not os.path.exists('no.csv'), 'a refused answer is written')


def views():
    """A view's map: a field of its own, which changes and goes as a whole."""
    try:
        sys.path.insert(0, PYTHON)
        import numpy as np
        import relight as client
    except ImportError as missing:
        print('views are left out: %s' % missing)
        return
    with client.Client('unix:socket') as c:
        green, own = {'wax': json.loads(GREEN)}, c.colors('open', 'constant')
        want = c.colors('open', 'constant', materials=green)
        both = c.colors('open', 'constant', materials=green, material='skimmilk')
        with c.view('open', 'constant', format='f32', materials=green) as view:
            for change, expected in (({}, want), ({'material': 'skimmilk'}, both), ({'material': ''}, want),
                                     ({'materials': {}}, own), ({'materials': green}, want)):
                number = view.set(**change) if change else 0
                frame = view.next()
                while frame.sequence < number:
                    frame = view.next()
                expect(np.abs(frame.colors - expected).max() < 1e-3 * expected.max(), 'a view: %s' % change)
            try:
                view.set(materials={'wick': 'marble'})
                while True:
                    view.next(20)
            except client.RelightError as error:
                expect('opaque' in str(error), 'a view: %s' % error)


def loads():
    """LOAD passes its map to the bake and to the preview."""
    own = ['--samples', '1500', '--cube', '16']
    given = material('wax=' + GREEN, 'foot=' + BROWN, GREY)
    prt('bake', 'candle.gltf', *own, '--transport', 'wavelet', *given, '-o', 'want.prt', '--quiet')
    relight('load', 'candle.gltf', '--name', 'mapped', *own, '--transport', 'wavelet', *given, '--wait')
    prt('colors', 'want.prt', *LIT, '-o', 'want.csv')
    relight('colors', 'mapped', *LIT, '-o', 'got.csv')
    same('got.csv', 'want.csv', 1e-6)
    info = json.loads(relight('info', 'mapped', '--json').stdout)
    names = {(b['node'], b['surface']): info['media'][b['medium']]['name'] for b in info['blocks'] if b['translucent']}
    expect(names == {('candle', 'wax'): 'green', ('pair', 'wax'): 'green', ('pair', 'holder'): 'grey',
                     ('foot', 'holder'): 'brown'}, 'media by object: %s' % names)
    relight('load', 'candle.gltf', '--name', 'sketch', *material('wax=' + GREEN), '--preview')
    prt('image', 'candle.gltf', *PICTURE, *DIPOLE, *material('wax=' + GREEN, 'marble'), '-o', 'want.png')
    relight('image', 'sketch', *PICTURE, '-o', 'got.png', '--engine', 'texture')
    same('got.png', 'want.png', 0.05)  # the wrong medium: 0.21
    # an edit of a preview
    prt('image', 'candle.gltf', *PICTURE, *DIPOLE, *material('wax=' + GREEN, 'holder=ketchup'), '-o',
        'want.png')
    relight('image', 'sketch', *PICTURE, '-o', 'got.png', '--engine', 'texture', *material('holder=ketchup'))
    same('got.png', 'want.png', 0.05)  # the wrong medium: 0.21
    said = relight('load', 'candle.gltf', '--name', 'bad', *material('w/x=marble'), status=2).said
    expect('neither a preset' in said, said)


def planes():
    """LOAD with planes of exit: a picture is prt's with them, and not prt's without."""
    own = ['--samples', '1500', '--cube', '16', '--transport', 'wavelet', *material('skin1')]
    prt('bake', 'candle.gltf', *own, '--exit-planes', '-o', 'want.prt', '--quiet')
    prt('bake', 'candle.gltf', *own, '-o', 'without.prt', '--quiet')
    relight('load', 'candle.gltf', '--name', 'planes', *own, '--exit-planes', '--wait')
    settings = json.loads(relight('info', 'planes', '--json').stdout)['settings']
    expect(settings.get('exit_planes') == 9, 'settings: %s' % settings)
    eye = [*LIT, '--eye', '60,40,150']
    relight('colors', 'planes', *eye, '-o', 'got.csv')
    prt('colors', 'want.prt', *eye, '-o', 'want.csv')
    same('got.csv', 'want.csv', 1e-5)
    prt('colors', 'without.prt', *eye, '-o', 'want.csv')
    said = prt('compare', 'got.csv', 'want.csv', '--max-rmse', '0.002', status=1).said
    expect('above' in said, said)


def any_index():
    """LOAD for any eta: media of other indices than the file's have prt's colours; one outside is refused."""
    own = ['--samples', '1500', '--cube', '16', '--transport', 'joint', '--any-eta']
    prt('bake', 'candle.gltf', *own, '-o', 'want.prt', '--quiet')
    relight('load', 'candle.gltf', '--name', 'indices', *own, '--wait')
    given = material('wax=' + GREEN.replace('1.5', '1.42'), 'foot=marble', 'skin1')
    prt('colors', 'want.prt', *LIT, *given, '-o', 'want.csv')
    relight('colors', 'indices', *LIT, *given, '-o', 'got.csv')
    same('got.csv', 'want.csv', 1e-5)
    outside = GREEN.replace('1.5', '1.65')
    said = relight('colors', 'indices', *LIT, '--material', outside, '-o', 'x.csv', status=2).said
    expect('eta is 1.65, this bake covers 1.2 to 1.6' in said, said)


def serve():
    os.mkdir('models')
    candle.write('candle.gltf')
    prt('bake', 'candle.gltf', '--samples', '1500', '--cube', '16', *material('wax=marble', 'holder=ketchup'),
        '-o', 'models/fixed.prt', '--quiet')
    prt('bake', 'candle.gltf', '--samples', '1500', '--cube', '16', '--transport', 'joint',
        *material('wax=marble', 'holder=ketchup'), '-o', 'models/open.prt', '--quiet')
    with daemon('--models', 'models', '--http', '127.0.0.1:0'):
        relight('load', 'fixed.prt')
        relight('load', 'open.prt')
        one_bake()
        maps()
        pictures()
        files()
        floors()
        previews()
        web()
        refusals()
        views()
        loads()
        planes()
        any_index()


main(serve)
