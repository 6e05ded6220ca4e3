#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""--room-hook: pins and decisions are posted over HTTPS, signed, and again where the server was busy;
a server whose certificate nobody signed gets nothing.  tests/service/room_hook.py BIN"""
import hashlib
import hmac
import http.server
import json
import os
import queue
import shutil
import socket
import ssl
import struct
import subprocess
import sys
import tempfile
import threading
import time

BIN = sys.argv[1]
KEY = 'a key of thirty-two bytes or more'


def fail(text):
    print('FAIL: ' + text)
    sys.exit(1)


class Hook(http.server.BaseHTTPRequestHandler):
    """The status that the room is called by, or 503, to the first of each delivery, then 204."""
    seen, told, got, last = [], [], queue.Queue(), ''

    def do_POST(self):
        body = self.rfile.read(int(self.headers['Content-Length']))
        delivery = self.headers['X-Relight-Delivery']
        first = delivery not in self.seen
        self.seen.append(delivery)
        self.told.append(json.loads(body))
        name = Hook.last = self.told[-1]['room_name']
        self.send_response(204 if not first else int(name) if name.isdigit() else 503)
        self.end_headers()
        if not first:
            self.got.put((self.path, dict(self.headers), body))

    def log_message(self, *_):
        pass


class Server6(http.server.ThreadingHTTPServer):
    address_family = socket.AF_INET6


def serve(kind, address, cert, key):
    """The server's port."""
    server = kind((address, 0), Hook)
    server.handle_error = lambda *_: None  # handshakes that the daemon breaks off
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(cert, key)
    server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server.server_address[1]


class Daemon:
    started = []

    def __init__(self, folder, target, trusted):
        self.folder, self.log = folder, os.path.join(folder, 'log')
        with open(os.path.join(folder, 'key'), 'w', encoding='utf-8') as f:
            f.write(KEY + '\n')
        env = dict(os.environ, SSL_CERT_FILE=trusted)
        with open(self.log, 'w', encoding='utf-8') as log:
            self.process = subprocess.Popen(
                [BIN + '/relightd', '--data', folder + '/data', '--models', folder, '--listen', 'unix:' + folder + '/s',
                 '--room-hook', 'https://%s/relight?x=1' % target, '--room-hook-key', folder + '/key'],
                stderr=log, env=env)
        self.started.append(self.process)
        self.wait(' start version')

    def wait(self, word):
        for _ in range(400):
            with open(self.log, encoding='utf-8') as f:
                if word in f.read():
                    return
            time.sleep(0.05)
        fail('"%s" does not come to stand in the log' % word)

    def relight(self, *words):
        done = subprocess.run([BIN + '/relight', '-s', 'unix:' + self.folder + '/s', *words], text=True,
                              capture_output=True, timeout=100, check=False)
        if done.returncode:
            fail('relight %s: %s' % (' '.join(words), done.stderr))
        return done.stdout

    def stop(self):
        self.process.terminate()
        if self.process.wait(30):
            fail('the daemon ended with %d' % self.process.returncode)
        with open(self.log, encoding='utf-8', errors='replace') as f:
            text = f.read()
        if 'Sanitizer: ' in text or ': runtime error: ' in text:
            fail(text)


def review(daemon, name):
    daemon.relight('room', 'create', name, '--model', 'small', '--env', 'constant:1,1,1', '--size', '64x48')
    daemon.relight('room', 'pin', name, 'too "red"', '--at', '0,1,0.2,0.2', '--as', 'Ann')
    daemon.relight('room', 'approve', name, 'fine', '--as', 'Bob')


def told_as_kept(daemon, told):
    """What was posted is what the room has."""
    room = json.loads(daemon.relight('room', 'show', told['room_name'], '--json'))
    of = [x for x in room['pins'] + room['decisions'] if int(x['stamp']['sequence']) == told['sequence']]
    if len(of) != 1 or told['room'] != room['room']:
        fail('nothing in the room has the number of %s' % told)
    kept, seen = of[0], of[0]['seen']
    want = {'time_us': int(kept['stamp']['time_us']), 'by': kept['stamp']['by'], 'name': kept['stamp'].get('name', ''),
            'revision': seen['revision'], 'model': seen['model'], 'bake_hash': seen.get('bake_hash', ''),
            'picture_hash': seen['picture_hash']}
    if told['event'] == 'pin':
        want['text'] = kept['notes'][0]['text']
    else:
        want.update(verdict='approved' if kept.get('approve') else 'rejected', note=kept['note'], hash=kept['hash'])
    for field, value in want.items():
        if told[field] != value:
            fail('%s is %r, the room has %r' % (field, told[field], value))


def statuses(daemon):
    """An answer of 2xx ends a delivery, as does a refusal, which is logged; a server that is busy is asked again."""
    for status, again in ((200, False), (299, False), (300, False), (302, False), (400, False), (404, False), (499, False),
                          (408, True), (429, True), (500, True), (599, True)):
        before = len(Hook.seen)
        daemon.relight('room', 'create', str(status), '--model', 'small', '--env', 'constant:1,1,1', '--size', '64x48')
        daemon.relight('room', 'approve', str(status))
        # Deliveries are made in their order: the one before has ended when another one's room is told.
        daemon.relight('room', 'approve', '200')
        for _ in range(1000):
            if len(Hook.seen) >= before + 2 + again and Hook.last == '200':
                break
            time.sleep(0.02)
        if len(Hook.seen) - before != 2 + again:
            fail('a server that answers with %d was asked %d times' % (status, len(Hook.seen) - before - 1))
        if status >= 300 and not again:
            daemon.wait('the server answers with status %d' % status)
    while not Hook.got.empty():
        Hook.got.get()


def part(number, value):
    """A field of a message: bytes, or a number."""
    if isinstance(value, int):
        return bytes([number << 3]) + size(value)
    return bytes([number << 3 | 2]) + size(len(value)) + value


def size(n):
    return (bytes([n & 127 | 128]) + size(n >> 7)) if n > 127 else bytes([n])


def frame(kind, request, header):
    return b'RLGT' + struct.pack('<BBHQIIQ', 1, 2, kind, request, len(header), 0, 0) + header


def told_as_it_was(daemon):
    """A message is about its event, whatever has followed it by the time it is on the disk."""
    room = daemon.relight('room', 'create', '200', '--model', 'small', '--env', 'constant:1,1,1', '--size',
                          '64x48').strip()
    stream = frame(1, 1, part(1, b'test') + part(2, 1) + part(3, 1))
    for i in range(10):
        for j, action in enumerate((part(8, part(1, b'as written') + part(2, b'')),  # a pin, its text, another name of the room
                       part(10, part(1, 2 + 3*i) + part(2, b'as changed')), part(2, part(1, b'%d' % (201 + i))))):
            stream += frame(31, 2 + 3*i + j, part(1, room.encode()) + part(2, action))
    with socket.socket(socket.AF_UNIX) as s:
        s.connect(daemon.folder + '/s')
        s.sendall(stream)
        for _ in range(1000):
            if sum(told['room'] == room for told in Hook.told) == 10:
                break
            time.sleep(0.02)
        else:
            fail('of 10 pins: %s' % Hook.told)
    name, was = '', {}
    for line in daemon.relight('room', 'log', room, '--json').splitlines():
        event = json.loads(line)
        kind = event['action']
        name = (kind.get('start') or kind.get('rename') or {'name': name})['name']
        was[int(event['stamp']['sequence'])] = name
    for told in Hook.told:
        if not isinstance(told['time_us'], int):
            fail('time_us is no whole number: %s' % told)
        if told['room'] == room and (told['room_name'], told.get('text')) != (was[told['sequence']], 'as written'):
            fail('of %s in the room %s: %s' % (told['sequence'], was[told['sequence']], told))


def main():
    folder = tempfile.mkdtemp()
    try:
        cert, key = folder + '/cert.pem', folder + '/tls.pem'
        subprocess.run(['openssl', 'req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256', '-nodes',
                        '-keyout', key, '-out', cert, '-days', '2', '-subj', '/CN=localhost', '-addext',
                        'subjectAltName=DNS:localhost,IP:::1'], check=True, capture_output=True)
        with open(folder + '/small.obj', 'w', encoding='utf-8') as f:
            f.write('v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\nf 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\n'
                    'f 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n')
        target = 'localhost:%d' % serve(http.server.ThreadingHTTPServer, '127.0.0.1', cert, key)

        d = Daemon(folder, target, cert)
        d.relight('load', 'small.obj', '--remote', '--size-mm', '20', '--material', 'marble', '--preview')
        model = json.loads(d.relight('info', 'small', '--json'))['model']
        review(d, 'first')
        for kind in ('pin', 'decision'):
            path, headers, body = Hook.got.get(timeout=20)
            told = json.loads(body)
            if headers['Host'] != target:
                fail('Host: %s, not %s' % (headers['Host'], target))
            if path != '/relight?x=1' or headers['X-Relight-Event'] != kind or told['event'] != kind:
                fail('%s: %s %s' % (kind, path, told))
            if told['room_name'] != 'first' or told.get('text', told.get('note')) not in ('too "red"', 'fine'):
                fail('%s' % told)
            if told['name'] != ('Ann' if kind == 'pin' else 'Bob') or len(told['picture_hash']) != 64:
                fail('%s' % told)
            if told['by'] != 'uid:%d' % os.getuid() or told['model'] != model:
                fail('by %s of %s: %s' % (os.getuid(), model, told))
            right = 'sha256=' + hmac.new(KEY.encode(), body, hashlib.sha256).hexdigest()
            if not hmac.compare_digest(right, headers['X-Relight-Signature']):
                fail('the signature is %s, not %s' % (headers['X-Relight-Signature'], right))
            told_as_kept(d, told)
        d.relight('room', 'reject', 'first', 'no')
        told = json.loads(Hook.got.get(timeout=20)[2])
        told_as_kept(d, told)
        if told['verdict'] != 'rejected':
            fail('of a rejection: %s' % told)
        statuses(d)
        told_as_it_was(d)
        d.stop()

        # Nobody whom this daemon trusts has signed the server's certificate.
        open(folder + '/none.pem', 'w', encoding='utf-8').close()
        d = Daemon(folder, target, folder + '/none.pem')
        review(d, 'second')
        time.sleep(1)
        d.stop()
        if not Hook.got.empty():
            fail('a server without a right certificate got %s' % Hook.got.get()[2])
        if socket.has_ipv6 and os.path.exists('/proc/net/if_inet6'):
            d = Daemon(folder, '[::1]:%d' % serve(Server6, '::1', cert, key), cert)
            review(d, 'third')
            if json.loads(Hook.got.get(timeout=20)[2])['room_name'] != 'third':
                fail('a server at an IPv6 address got something else')
            d.stop()
        for url in ('http://localhost/', 'https://', 'https://a b/', 'https://a:99999999/', 'https://a@b/', 'https://[::1/',
                    'https://[]/', 'https://[::1]x/'):
            done = subprocess.run([BIN + '/relightd', '--data', folder + '/other', '--listen', 'unix:' + folder + '/o',
                                   '--room-hook', url, '--room-hook-key', folder + '/key'],
                                  capture_output=True, text=True, timeout=30, check=False)
            if not done.returncode or 'https://HOST' not in done.stderr:
                fail('--room-hook %s: %s' % (url, done.stderr))
        print('room_hook: fine')
    finally:
        for process in Daemon.started:
            process.kill()  # where the test failed: it would be waited for
        shutil.rmtree(folder)


main()
