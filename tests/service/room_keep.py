#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What rooms need stays on a disk that is full: a pin on a baked model under an uploaded light is
drawn with the same bytes after other models and uploads had to make room, an upload and a bake that do
not fit any more are refused with the rooms as the reason, and once the room is deleted its files go. A pin on
a pose is drawn again after a restart; a model that a room needs is not forgotten but by force, and a file of --models that
was replaced or removed stays for the pins, and so does a model whose bake failed.

   tests/service/room_keep.py BIN [CHECK…]      CHECK: a function's name, all without one; RELIGHT_TEST_POSTGRES: the
                                                rooms of check_replicas are there"""
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
import animated  # noqa: E402
from programs import daemon, expect, main, prt, relight  # noqa: E402

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


def write_ball(name):
    with open(name + '.obj', 'w', encoding='utf-8') as f:
        f.write('# %s\n' % name + BALL)


def load(name, *options, at=''):
    write_ball(name)
    relight('load', name + '.obj', '--size-mm', '20', '--material', 'marble', '--samples', '300', '--cube', '16',
            *options, at=at)


def read(path):
    with open(path, 'rb') as f:
        return f.read()


def wait_until(what, good):
    for _ in range(6000):
        if good():
            return
        time.sleep(0.05)
    expect(False, what)


def wait_for_log(text, at=''):
    wait_until('the log has no "%s"' % text, lambda: text in read(at + 'log').decode())


def blob(hash_of):
    return 'data/blobs/' + hash_of


def age(hash_of, days):
    """As if it had been used so long ago: an upload of the last minutes stays anyway."""
    when = time.time() - days * DAY
    os.utime(blob(hash_of), (when, when))


def upload(light, status=0):
    return relight('env', light, status=status)


def pin(name):
    return shown(PIN, name)


def shown(number, name):
    relight('room', 'show', ROOM, str(number), '-o', name)
    return read(name)


def make_pin(text):
    return json.loads(relight('room', 'pin', ROOM, text, '--at', '0,2,0.3,0.2', '--json').stdout)['sequence']


def disk_used():
    return json.loads(relight('stats', '--json').stdout)['relightd_disk_bytes']


def set_up():
    """A room with a pin; then, used later, a model and lights that no room needs."""
    global PIN
    with daemon('--data', 'data'):
        load('kept', '--wait')
        relight('room', 'create', ROOM, '--model', 'kept', '--env', 'kept.hdr', '--size', '64x48')
        PIN = str(make_pin('too red'))
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
        db.executescript('ALTER TABLE room DROP COLUMN keeps; ALTER TABLE invite DROP COLUMN inviter; '
                         'PRAGMA user_version=2')


def check():
    kept = write_light('kept.hdr', 1)
    spare = [write_light('spare%d.hdr' % i, 1 + i) for i in (1, 2)]
    more = [write_light('more%d.hdr' % i, 5 + i) for i in range(4)]
    tiny = write_light('tiny.hdr', 9, 128, 64)
    first, used = set_up()
    expect(len(bakes()) == 2, 'bakes: %s' % bakes())
    age(kept, 3)
    for one in spare:
        age(one, 2)
    small = ['--data', 'data', '--disk', str(used + 4 * BLOCK)]
    forget_what_rooms_need()
    with daemon(*small):
        upload('more0.hdr')
        upload('more1.hdr')
        expect(not all(os.path.exists(blob(one)) for one in spare), 'no upload went: %s' % read('log').decode())
        expect(len(bakes()) == 2, 'a bake went before an upload that nobody uses')
        upload('tiny.hdr')
        expect(len(bakes()) == 1, 'the bake that no room needs stays')
        expect(os.path.exists(blob(kept)), 'the light of the pin went')
        expect(pin('second.png') == first, 'other bytes after others made room')
    age(kept, 3)
    for one in spare + more[:2] + [tiny]:
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


def age_shared(hash_of):
    os.utime(shared(hash_of), (time.time() - 3 * DAY,) * 2)


def light_and_pin(light, by):
    """A pin under a light that the room's scene has for this pin alone; its picture."""
    relight('room', 'scene', ROOM, '--env', light, at=by)
    said = relight('room', 'pin', ROOM, light, '--at', '0,2,0.3,0.2', '--json', at=by).stdout
    relight('room', 'scene', ROOM, '--env', 'constant', at=by)
    number = str(json.loads(said)['sequence'])
    relight('room', 'show', ROOM, number, '-o', light + '.png', at=by)
    return number


def same_by(number, light, by):
    relight('room', 'show', ROOM, number, '-o', 'again.png', at=by)
    expect(read('again.png') == read(light + '.png'), 'other bytes of the pin under %s by %s' % (light, by))


def check_replicas():
    """One replica removes what nobody used for a day from the folder: not what a room of another one begins to need
    meanwhile, and what was removed before it was needed is put there again."""
    database = os.environ.get('RELIGHT_TEST_POSTGRES')
    kept, spare, removed = [write_light(name + '.hdr', 20 + i) for i, name in enumerate(NAMES)]
    options = ['--store', 'shared', '--store-keep', str(DAY), '--store-poll', '0.2']
    options += ['--rooms', database] if database else []
    with daemon('--data', 'one', *options, at='one-'):
        expect(('use --rooms postgresql://' in read('one-log').decode()) == (not database), 'the advice at the start')
        load('kept', '--wait', at='one-')
        for name in NAMES:
            relight('env', name + '.hdr', at='one-')
        relight('room', 'create', ROOM, '--model', 'kept', '--env', 'constant', '--size', '64x48', at='one-')
        wait_for_log('start version', 'one-')
        time.sleep(1)  # the first look has ended
        for one in (kept, spare):
            age_shared(one)
        for path in (shared(removed), shared(removed) + '.owner'):
            os.unlink(path)
        pins = [(light_and_pin(light, 'one-'), light) for light in ('kept.hdr', 'removed.hdr')]
        wait_until('what a pin needs is not put again', lambda: os.path.exists(shared(removed)))
        wait_until('what a pin needs is not used now', lambda: os.path.getmtime(shared(kept)) > time.time() - DAY)
        with daemon('--data', 'two', *options, '--store-poll', '20', at='two-'):
            wait_for_log('store removed=', 'two-')
            expect(not os.path.exists(shared(spare)), 'what nobody needs stays')
            expect(os.path.exists(shared(kept)), 'the other replica removed what a pin needs')
            for number, light in pins if database else []:
                same_by(number, light, 'two-')
            if database:  # a model that came since its last look at the folder
                load('later', '--wait', at='one-')
                relight('room', 'scene', ROOM, '--model', 'later', at='one-')
                relight('room', 'pin', ROOM, 'at once', '--at', '0,2,0.3,0.2', at='two-')
    if not database:
        return
    # The replica that wrote the rooms is away, and nothing was used for days.
    with open('spare.hdr', 'rb') as f:
        data = f.read()
    with open(shared(spare), 'wb') as f:
        f.write(data)
    for one in (kept, removed, spare):
        age_shared(one)
    with daemon('--data', 'three', *options, at='three-'):
        wait_for_log('store removed=', 'three-')
        expect(not os.path.exists(shared(spare)), 'what nobody needs stays, the second time')
        for number, light in pins:
            same_by(number, light, 'three-')
def act(action, status=0):
    return relight('room', 'act', ROOM, json.dumps(action), status=status).said


def at_pose(pose, status=0):
    model = json.loads(relight('info', 'bar', '--json').stdout)['model']
    return act({'scene': {'scene': {'model': model, 'pose': pose}, 'parts': ['model']}}, status)


def check_poses():
    """A pin on vertices that a client sent has the same bytes after a restart."""
    animated.bar().write('bar.gltf')
    options = ['--data', 'posed']
    with daemon(*options):
        relight('load', 'bar.gltf', '--name', 'bar', '--size-mm', '20', '--material', 'skin1', '--preview')
        relight('room', 'create', ROOM, '--model', 'bar', '--env', 'constant', '--size', '64x48', '--engine', 'texture')
        pose, other = (relight('pose', 'bar', 'bar.gltf', '--animation', 'bend', '--time', t).stdout.strip()
                       for t in ('0.5', '1'))
        said = at_pose('0' * 64, status=1)
        expect('PUT_POSE' in said, 'a pose that is not there: ' + said)
        straight = make_pin('straight')
        at_pose(pose)
        bent = make_pin('bent')
        first = [shown(straight, 'straight.png'), shown(bent, 'bent.png')]
        expect(first[0] != first[1], 'the pose is not drawn')
        expect(os.path.exists('posed/blobs/' + pose), 'the pose is not on the disk')
        expect(not os.path.exists('posed/blobs/' + other), 'a pose that no room names is on the disk')
        held = json.loads(relight('stats', '--json').stdout)['relightd_resource_held{resource="payload"}']
        # A request holds some bytes of its own.
        expect(held < os.path.getsize('posed/blobs/' + pose), 'a kept pose stays charged as a payload: %s bytes' % held)
    with daemon(*options):
        expect(shown(bent, 'again.png') == first[1], 'other bytes of the posed pin after a restart')
        expect(shown(straight, 'again.png') == first[0], 'other bytes of the straight pin after a restart')
        relight('image', 'bar', '--env', 'constant', '--size', '32x24', '--engine', 'texture', '--pose', pose, '-o', 'p.png')
        said = relight('image', 'bar', '--env', 'constant', '--pose', other, '-o', 'p.png', status=1).said
        expect('send it again' in said, 'a pose that nobody kept: ' + said)
        load('ball', '--preview')
        said = relight('image', 'ball', '--env', 'constant', '--engine', 'texture', '--pose', pose, '-o', 'p.png',
                       status=2).said
        expect('it is of another model' in said, 'the pose of another model: ' + said)
        relight('load', 'bar.gltf', '--name', 'waxen', '--size-mm', '20', '--material', 'ketchup', '--preview')
        relight('image', 'waxen', '--env', 'constant', '--size', '32x24', '--engine', 'texture', '--pose', pose, '-o', 'p.png')
    with open('posed/blobs/' + pose, 'r+b') as f:
        f.seek(40)
        f.write(b'damaged')
    with daemon(*options):
        said = relight('room', 'show', ROOM, str(bent), '-o', 'bad.png', status=1).said
        expect('pose' in said, 'a damaged pose: ' + said)
        wait_for_log('could not be read: its file is damaged')
        expect(shown(straight, 'again.png') == first[0], 'other bytes beside a damaged pose')


def check_forget():
    """A model that a room needs is forgotten by force alone."""
    with daemon('--data', 'forgotten'):
        load('kept', '--wait')
        relight('room', 'create', ROOM, '--model', 'kept', '--env', 'constant', '--size', '64x48')
        number = make_pin('too red')
        first = shown(number, 'first.png')
        room = json.loads(relight('room', 'list', '--json').stdout)[0]['room']
        said = relight('unload', 'kept', '--forget', status=2).said
        expect('1 review room needs it: ' + room in said and '--force' in said, 'the refusal: ' + said)
        relight('unload', 'kept')  # from memory alone
        expect(shown(number, 'again.png') == first, 'other bytes after a refusal')
        token = relight('token', 'create', '--name', 'anna', '--scope', 'view,edit,upload').stdout.split()[0]
        os.environ['RELIGHT_TOKEN'] = token
        said = relight('unload', 'kept', '--forget', '--force', status=1).said
        del os.environ['RELIGHT_TOKEN']
        expect('admin' in said, 'force without the right: ' + said)
        relight('unload', 'kept', '--forget', '--force')
        expect(relight('room', 'show', ROOM, str(number), '-o', 'x.png', status=1).said, 'it is there')


FAILURES = 256  # that a daemon keeps


def check_failures():
    """The preview of a bake that was cancelled stays for its room, however many bakes are cancelled after it."""
    write_ball('kept')

    def order(size_mm):
        return json.loads(relight('load', 'kept.obj', '--size-mm', str(size_mm), '--material', 'marble', '--samples',
                                  '2000000', '--no-draft', '--name', 'ball%d' % size_mm, '--json').stdout)

    with daemon('--data', 'failures', '--bakes', '1'):
        order(10)  # takes the only place: the others wait for it
        relight('cancel', order(11)['job'])
        relight('room', 'create', ROOM, '--model', 'ball11', '--env', 'constant', '--size', '64x48', '--engine', 'texture')
        number = make_pin('of a preview')
        first = shown(number, 'first.png')
        for i in range(FAILURES + 2):
            relight('cancel', order(12 + i)['job'])
        expect(shown(number, 'again.png') == first, 'other bytes after many failures')


def bake(name, material):
    prt('bake', 'kept.obj', '--size-mm', '20', '--material', material, '--samples', '300', '--cube', '16', '-o', name,
        '--quiet')


def check_replaced():
    """Pins on a file of --models that has other content now, or is gone."""
    os.mkdir('models')
    write_ball('kept')
    bake('models/flat.prt', 'marble')
    options = ['--data', 'replaced', '--models', 'models', '--poll', '0.2']
    with daemon(*options):
        relight('room', 'create', ROOM, '--model', 'flat', '--env', 'constant', '--size', '64x48')
        marble = make_pin('marble')
        first = shown(marble, 'first.png')
        bake('next.prt', 'ketchup')
        os.rename('next.prt', 'models/flat.prt')
        wait_for_log('is replaced by')
        relight('room', 'scene', ROOM, '--model', 'flat')
        ketchup = make_pin('ketchup')
        second = shown(ketchup, 'second.png')
        expect(first != second, 'the name stands for the old file')
        time.sleep(1)  # some scans
        expect(shown(marble, 'again.png') == first, 'other bytes after the file was replaced')
    os.remove('models/flat.prt')
    for start in ('first', 'second'):
        with daemon(*options):
            time.sleep(1)
            expect(shown(marble, 'again.png') == first, 'replaced: other bytes after the %s start' % start)
            expect(shown(ketchup, 'again.png') == second, 'removed: other bytes after the %s start' % start)
            said = relight('info', 'flat', status=1).said
            expect('no such model' in said, 'the name of a file that is gone: ' + said)
    with daemon(*options, '--rooms-keep', '0.001'):
        relight('room', 'close', ROOM)
        wait_for_log('deleted=closed')
        wait_for_log('has no file any more')


def check_snapshot():
    """A daemon that ends leaves a snapshot of a room with many events, so that the next one reads few of them."""
    with daemon('--data', 'long'):
        relight('room', 'create', ROOM)
        room = json.loads(relight('room', 'list', '--json').stdout)[0]['room']
        for i in range(260):
            relight('room', 'rename', room, 'name %d' % i)
    with contextlib.closing(sqlite3.connect('long/rooms.sqlite')) as db:
        last, = db.execute('SELECT max(sequence) FROM event').fetchone()
        behind, = db.execute('SELECT max(sequence) FROM snapshot').fetchone()
    expect(last > 260, 'the room has %s events' % last)
    expect(behind is not None and last - behind < 250, 'snapshot %s of %s events' % (behind, last))
    with daemon('--data', 'long'):
        said = relight('room', 'list', '--json').stdout
        expect('name 259' in said, 'the room after a restart: ' + said)


ROOM = 'a full disk'
PIN = ''
NAMES = ('kept', 'spare', 'removed')
main(*([globals()[n] for n in sys.argv[2:]] or
       [check, check_shared_folder, check_replicas, check_poses, check_forget, check_failures, check_replaced,
        check_snapshot]))
