#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Which scattering `prt bake` chooses and why, where the dipole differs from walks by `prt info`, and the legend of
`prt image --term difference`.

   tests/unit/scattering.py BIN"""
import json
import os
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from programs import expect, main, prt  # noqa: E402

SMALL = ['--size-mm', '10', '--samples', '500', '--cube', '16', '--no-single']


def write_plate(path, thickness=0.1, faces=6):
    """A plate of 2 x 2 and this thickness; with fewer faces it is open."""
    at = [(x, y * thickness / 2, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    face = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    with open(path, 'w', encoding='utf-8') as out:
        for p in at:
            out.write('v %g %g %g\n' % p)
        for f in face[:faces]:
            out.write('f %d %d %d %d\n' % f)


def chosen(*options):
    """The note of a bake that is estimated, and the estimate."""
    run = prt('bake', *options, '--size-mm', '10', '--estimate', '--json')
    note = [line for line in run.stderr.splitlines() if '--scattering' in line]
    return note[0] if note else '', json.loads(run.stdout)['cpu_seconds']


def choice():
    fixed = ['--material', 'marble']
    note, seconds = chosen('plate.obj', *fixed)
    expect('--scattering walk: the bodies are closed' in note, 'a closed body: ' + note)
    said, dipole = chosen('plate.obj', *fixed, '--scattering', 'dipole')
    expect(not said, 'a choice where one was given: ' + said)
    said, walk = chosen('plate.obj', *fixed, '--scattering', 'walk')
    expect(abs(walk - seconds) < 1e-6 and dipole < walk <= 3 * dipole, 'times %g %g %g' % (dipole, walk, seconds))
    for words, options in (('more than 3', ['plate.obj', *fixed, '--samples', '500', '--cube', '16']),
                           ('boundary edges', ['open.obj', *fixed]),
                           ('free medium', ['plate.obj']),
                           ('sparse', ['plate.obj', *fixed, '--storage', 'sparse']),
                           ('draft', ['plate.obj', *fixed, '--draft']),
                           ('profile', ['plate.obj', '--material', '{"profile":"burley","albedo":[0.9,0.8,0.6],'
                                        '"mean_free_path":[4,2.5,1.5]}'])):
        note, _ = chosen(*options)
        expect('--scattering dipole: ' in note and words in note, '%s: %s' % (words, note))
    # the choice of the dipole gives the bytes of the dipole
    prt('bake', 'plate.obj', *fixed, *SMALL, '-o', 'chosen.prt')
    prt('bake', 'plate.obj', *fixed, *SMALL, '--scattering', 'dipole', '-o', 'given.prt')
    with open('chosen.prt', 'rb') as a, open('given.prt', 'rb') as b:
        expect(a.read() == b.read(), 'the chosen dipole has other bytes')
    # which has no unscattered light: neither black colours, nor a picture, nor an error of 0
    for words in (['colors', 'given.prt', '-o', 'u.csv'], ['colors', 'given.prt', '--engine', 'reference', '-o', 'u.csv'],
                  ['image', 'given.prt', '-o', 'u.exr'], ['compare', 'given.prt', 'reference']):
        said = prt(*words, '--env', 'constant', '--term', 'unscattered', status=2).stderr
        expect('no unscattered light: bake with' in said, said)
    prt('colors', 'given.prt', '--engine', 'reference', '--scattering', 'walk', '--walks', '16', '--env', 'constant',
        '--term', 'unscattered', '-o', 'u.csv')


def errors_of_draft(*options):
    bake = prt('bake', 'thick.obj', '--size-mm', '10', '--material', 'marble', '--draft', '--no-single', '--json',
               '-o', 'draft.prt', *options)
    return json.loads(bake.stdout)['errors']


def compared(path):
    """RMSE of a .prt's multiple scattering from walks under even light."""
    run = prt('compare', path, 'reference', '--scattering', 'walk', '--walks', '2048', '--term', 'multiple', '--env',
              'constant', '--json')
    return json.loads(run.stdout)['rmse_without_noise']


def drafts():
    """A draft that a bake by walks replaces returns what walks return under even light, and its
    errors are against walks."""
    write_plate('thick.obj', 1)
    off, errors = [], []
    for options in ((), ('--scattering', 'walk'), ('--scattering', 'dipole')):
        errors.append(errors_of_draft(*options))
        off.append(compared('draft.prt'))
    walk, given, dipole = errors
    expect(walk == given and 'reference_walks' in walk and 'reference_walks' not in dipole, 'references of drafts')
    expect(dipole['multiple']['worst'] < 0.05, 'the dipole against itself: %s' % dipole['multiple'])
    expect(off[0] < 0.04 and off[0] == off[1] and off[2] > 0.15, 'drafts against walks under even light: %s' % off)
    expect(off[0] < 2 * walk['multiple']['worst'], 'a draft further off than it says: %s, %s' % (off[0], walk['multiple']))


def where():
    run = prt('info', 'plate.obj', '--size-mm', '10', '--material', 'skimmilk', '--walks', '32', '--json')
    error = json.loads(run.stdout)['dipole_error']
    expect(len(error) == 1 and error[0]['medium'] == 'Skimmilk' or error[0]['medium'].lower() == 'skimmilk', str(error))
    error = error[0]
    # in the middle of a plate that is thin against the free path the dipole returns light twice
    expect(error['brightest'] > 0.3 and error['rms'] > 0.2 and error['above_tenth'] > 0.3, str(error))
    at = error['brightest_at']
    expect(abs(at[0]) <= 1 and abs(at[2]) <= 1 and abs(abs(at[1]) - 0.05) < 0.01, 'not on the faces: %s' % at)
    expect('too bright, most at' in error['words'], error['words'])
    expect('dipole_error' not in json.loads(prt('info', 'plate.obj', '--json').stdout), 'walks that nobody asked for')
    said = prt('info', 'plate.obj', '--size-mm', '10', '--material', 'marble', '--walks', '3', status=2).stderr
    expect('16' in said, 'the range of --walks: ' + said)
    prt('info', 'open.obj', '--size-mm', '10', '--material', 'marble', '--walks', '16')


def legend():
    run = prt('image', 'plate.obj', '--size-mm', '10', '--material', 'skimmilk', '--env', 'constant', '--size', '32x24',
              '--term', 'difference', '--scattering', 'walk', '--walks', '16', '--samples', '500', '--rays', '32',
              '--json', '-o', 'd.png')
    legend = {item['excess']: item['color'] for item in json.loads(run.stdout)['legend']}
    expect(legend[0] == '#ffffff' and legend[1] == '#ff0000' and legend[-0.5] == '#0000ff', str(legend))
    expect(sorted(legend) == list(legend), 'the legend does not ascend: %s' % legend)


def check():
    write_plate('plate.obj')
    write_plate('open.obj', faces=5)
    choice()
    drafts()
    where()
    legend()


main(check)
