#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What rooms need stays on a disk that is full: a pin on a baked model under an uploaded light is
drawn with the same bytes after other models and uploads had to make room, an upload and a bake that do
not fit any more are refused with the rooms as the reason, and once the room is deleted its files go.

   tests/service/room_keep.py BIN"""
import contextlib
import hashlib
import json
import os
import random
import sqlite3
import sys
import time

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'unit'))
from programs import daemon, expect, main, relight  # noqa: E402

BALL = ('v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\nf 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\n'
        'f 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n')
DAY = 86400
BLOCK = 4096


def write_light(name, seed, width=256, height=128):
    """A Radiance file of flat pixels; returns its hash."""
    numbers = random.Random(seed)
    pixels = b''.join(bytes((numbers.randrange(20, 200), numbers.randrange(20, 200), numbers.randrange(20, 200), 129))
                      for _ in range(width * height))
    data = b'#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n' % (height, width) + pixels
    with open(name, 'wb') as f:
        f.write(data)
    return hashlib.sha256(data).hexdigest()


def load(name, *options):
    with open(name + '.obj', 'w', encoding='utf-8') as f:
        f.write('# %s\n' % name + BALL)
    relight('load', name + '.obj', '--size-mm', '20', '--material', 'marble', '--samples', '300', '--cube', '16',
            *options)


def read(path):
    with open(path, 'rb') as f:
        return f.read()


def log_has(text):
    return text in read('log').decode()


def wait_for_log(text):
    for _ in range(6000):
        if log_has(text):
            return
        time.sleep(0.05)
    expect(False, 'the log has no "%s"' % text)


def blob(hash_of):
    return 'data/blobs/' + hash_of


def age(hash_of, days):
    """As if it had been used so long ago: an upload of the last minutes stays anyway."""
    when = time.time() - days * DAY
    os.utime(blob(hash_of), (when, when))


def upload(light, status=0):
    return relight('env', light, status=status)


def pin(name):
    relight('room', 'show', ROOM, PIN, '-o', name)
    return read(name)


def disk_used():
    return json.loads(relight('stats', '--json').stdout)['relightd_disk_bytes']


def set_up():
    """A room with a pin; then, used later, a model and lights that no room needs."""
    global PIN
    with daemon('--data', 'data'):
        load('kept', '--wait')
        relight('room', 'create', ROOM, '--model', 'kept', '--env', 'kept.hdr', '--size', '64x48')
        PIN = str(json.loads(relight('room', 'pin', ROOM, 'too red', '--at', '0,2,0.3,0.2', '--json').stdout)['sequence'])
        relight('room', 'scene', ROOM, '--env', 'constant')  # the pin's revision alone has the light
        first = pin('first.png')
        upload('spare1.hdr')
        upload('spare2.hdr')
        load('spare', '--wait')
        used = disk_used()
    return first, used


def bakes():
    return sorted(f for f in os.listdir('data/bakes') if f.endswith('.prt'))


def forget_what_rooms_need():
    """The rooms as the version before wrote them."""
    with contextlib.closing(sqlite3.connect('data/rooms.sqlite')) as db:
        db.executescript('ALTER TABLE room DROP COLUMN keeps; PRAGMA user_version=2')


def check():
    kept = write_light('kept.hdr', 1)
    spare = [write_light('spare%d.hdr' % i, 1 + i) for i in (1, 2)]
    more = [write_light('more%d.hdr' % i, 5 + i) for i in range(4)]
    first, used = set_up()
    expect(len(bakes()) == 2, 'bakes: %s' % bakes())
    age(kept, 3)
    for one in spare:
        age(one, 2)
    small = ['--data', 'data', '--disk', str(used + 4 * BLOCK)]
    forget_what_rooms_need()
    with daemon(*small):
        upload('more0.hdr')
        expect(len(bakes()) == 1, 'the bake that no room needs stays')
        upload('more1.hdr')
        expect(os.path.exists(blob(kept)), 'the light of the pin went')
        expect(not all(os.path.exists(blob(one)) for one in spare), 'no upload went: %s' % read('log').decode())
        expect(pin('second.png') == first, 'other bytes after others made room')
    age(kept, 3)
    for one in spare + more[:2]:
        if os.path.exists(blob(one)):
            age(one, 2)
    tight = ['--data', 'data', '--disk', str(os.path.getsize(blob(kept)) + 8 * BLOCK)]
    with daemon(*tight):
        said = upload('more2.hdr', status=1).said
        expect('review rooms need' in said and '--rooms-keep' in said, 'the refused upload: ' + said)
        said = relight('load', 'kept.obj', '--size-mm', '25', '--material', 'marble', status=1).said
        expect('review rooms need' in said, 'the refused bake: ' + said)
        expect(pin('third.png') == first, 'other bytes after a refused upload')
        relight('room', 'close', ROOM)
        expect(pin('fourth.png') == first, 'other bytes in a closed room')
    age(kept, 3)
    with daemon(*tight, '--rooms-keep', '0.001'):
        wait_for_log('deleted=closed')
        upload('more3.hdr')
        expect(not bakes(), 'the bake stays when its room is deleted')
        expect(not os.path.exists(blob(kept)), 'the light stays when its room is deleted')


def shared(hash_of):
    return 'shared/blobs/%s/%s' % (hash_of[:2], hash_of)


def check_shared_folder():
    """What nobody used for a day is removed from the folder that replicas share, but for the rooms' things."""
    kept, spare = write_light('kept.hdr', 1), write_light('spare1.hdr', 2)
    options = ['--data', 'replica', '--store', 'shared', '--store-keep', str(DAY)]
    with daemon(*options):
        load('kept', '--wait')
        relight('room', 'create', ROOM, '--model', 'kept', '--env', 'kept.hdr', '--size', '64x48')
        said = relight('room', 'pin', ROOM, 'too red', '--at', '0,2,0.3,0.2', '--json').stdout
        relight('room', 'scene', ROOM, '--env', 'constant')
        upload('spare1.hdr')
    for one in (kept, spare):
        os.utime(shared(one), (time.time() - 3 * DAY,) * 2)
    with daemon(*options):
        wait_for_log('store removed=')
        expect(not os.path.exists(shared(spare)), 'an upload that nobody uses stays in the shared folder')
        expect(os.path.exists(shared(kept)), 'the light of the pin went from the shared folder')
        relight('room', 'show', ROOM, str(json.loads(said)['sequence']), '-o', 'shared.png')
        expect(read('shared.png') == read('first.png'), 'other bytes by a replica')


ROOM = 'a full disk'
PIN = ''
main(check, check_shared_folder)
