#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What a person types wrongly is told as a line that says what was expected: one row a fault, of each program. The
daemon has a room, since its commands look for it first.

   tests/service/usage_errors.py PATH/TO/bin"""
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', 'unit'))
from programs import daemon, expect, main, relight, run  # noqa: E402

LIGHT = '--env constant'

# program, arguments, what is said
ROWS = [
    ('relight', 'colors x --rotate 10 --rotate 20 %s -o x.csv' % LIGHT, '2 --rotate for 1 --env'),
    ('relight', 'colors x --gain 2 --gain 3 %s -o x.csv' % LIGHT, '2 --gain for 1 --env'),
    ('relight', 'image x %s --bump-mm 1 -o x.png' % LIGHT, '--bump-mm is for --bump-map'),
    ('relight', 'image x %s -o x.gif' % LIGHT, 'end in one of .jpg, '),
    ('relight', 'image x %s -o .png/x' % LIGHT, 'end in one of'),
    ('relight', 'edit x %s -o x.png' % LIGHT, '--material is missing'),
    ('relight', 'edit x %s --material jade -o x.hdr' % LIGHT, '.csv, .npy, .ply, .glb'),
    ('relight', 'edit x %s --material jade --albedo-map skin.jpg -o x.csv' % LIGHT, 'and --bump-map are for pictures'),
    ('relight', 'update-vertices x', '--positions is missing'),
    ('relight', 'load x --env constant --env constant', 'one --env at most'),
    ('relight', 'image x --gain 2 -o x.png', '--rotate and --gain are for --env'),
    ('relight', 'image x -o x.png', '--env is missing'),
    ('relight', 'load x --rotate 30', '--rotate is for --env'),
    ('relight', 'load x --env constant --rotate 30 --rotate 60', '--rotate is for --env'),
    ('relight', 'token create --scope view', '--name is missing'),
    ('relight', 'token create --name a', '--scope is missing: view, edit, upload, admin'),
    ('relight', 'token create --name a --scope view --rate 0', 'expected a number in [1e-06, 1e+09]'),
    ('relight', 'token revoke', 'NAME is missing'),
    ('relight', 'token forge', 'expected create, list or revoke'),
    ('relight', 'ping here', 'one argument too many: here'),
    ('relight', 'colors x %s --eye 1,2 -o x.csv' % LIGHT, 'expected three numbers x,y,z'),
    ('relight', 'room compare r --layout round -o x.png', 'expected sheet, side, wipe or delta'),
    ('relight', 'room compare r -o x.jpg', 'a name that ends in .png'),
    ('relight', 'room show r -o x.jpg', '.png or .exr'),
    ('relight', 'room show r seven -o x.png', "expected a pin's number"),
    ('relight', 'room show r 1 --revision 1 -o x.png', 'one of PIN, --decision and --revision'),
    ('relight', 'room show r --decision 1 --revision 1 -o x.png', 'one of PIN, --decision and --revision'),
    ('relight', 'room show r --revision 1', '--decision and --revision are for a picture'),
    ('relight', 'room variant r night --material wick=jade', 'is for all objects'),
    ('relight', 'room pin r words', '--at OBJECT,TRIANGLE,B1,B2 is missing'),
    ('relight', 'room pin r words --at 1,2', 'expected OBJECT,TRIANGLE,B1,B2'),
    ('relight', 'room act r [1', 'expected a RoomAction as JSON'),
    ('relight', 'room export r', '-o FOLDER is missing'),
    ('relight', 'room scene r --rotate 3', '--rotate and --gain are for --env'),
    ('relight-preview', 'x %s -o x.gif' % LIGHT, '-o FILE has to end in .exr'),
    ('relight-preview', 'x %s --sheet -o x.mp4' % LIGHT, 'a film has neither --sheet nor --difference'),
    ('relight-preview', 'x %s --difference --try jade --try marble -o x.exr' % LIGHT, 'end in .png, with a background'),
    ('relight-preview', '--follow r -o x.hdr', 'the daemon writes .jpg, '),
    ('relight-preview', '--follow r --env constant -o x.png', 'the room has the model'),
    ('relight-preview', '--follow r --sheet -o x.png', 'no --sheet, --difference or --turn'),
    ('relight-preview', 'x y %s -o x.png' % LIGHT, 'one argument too many: y'),
    ('relight-preview', '%s -o x.png' % LIGHT, 'ID is missing'),
    ('relight-preview', 'x -o x.png', '--env is missing'),
    ('relight-control', 'view x %s --device 12:34 -o -' % LIGHT, 'expected VENDOR:PRODUCT, four hex digits each'),
    ('relight-control', '--list --check x', 'only one of --list, --learn and --check'),
    ('relight-control', 'view x %s --steer wheel -o -' % LIGHT, 'expected light or camera'),
    ('relight-control', '--steer light', 'ID or ROOM is missing'),
    ('prt', 'image x.prt %s --camera 1,2 -o x.png' % LIGHT, 'must be three finite numbers x,y,z'),
    ('prt', 'image x.prt %s --camera 1,2,3 -o x.png' % LIGHT, 'TARGET is missing'),
    ('prt', 'image x.prt %s --camera 1,2,3:0,0,0:0,1,0:170 -o x.png' % LIGHT, 'field of view 170 is outside (0,170) degrees'),
    ('prt', 'image x.prt %s --orbit 30 -o x.png' % LIGHT, 'expected AZIMUTH,ELEVATION[,ZOOM]'),
    ('prt', 'image x.prt %s --orbit 30,91 -o x.png' % LIGHT, 'the elevation is in [-90, 90] degrees'),
    ('prt', 'image x.prt %s --orbit 30,0,101 -o x.png' % LIGHT, 'the zoom in [0.1, 100]'),
    ('prt', 'image x.prt %s --exposure 41 -o x.png' % LIGHT, 'expected a number in [-40, 40]'),
    ('prt', 'image x.prt %s -o x.gif' % LIGHT, '.exr, .hdr, .png'),
    ('relightd', 'here', 'unexpected argument; only options are accepted'),
]


def check():
    with open('tetrahedron.obj', 'w', encoding='utf-8') as f:
        f.write('v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n')
    with daemon('--data', 'data'):
        relight('load', 'tetrahedron.obj', '--mm-per-unit', '10', '--material', 'marble', '--preview', '--name', 'x')
        relight('room', 'create', 'r', '--model', 'x', '--env', 'constant')
        for program, arguments, text in ROWS:
            at = ['-s', 'unix:socket'] if program not in ('prt', 'relightd') else []
            said = run(program, *at, *arguments.split(' '), status=2).said
            expect(text in said, '%s %s: no "%s" in: %s' % (program, arguments, text, said))


main(check)
