#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The relight program against a daemon whose names and errors hold control characters: nothing that
a terminal would obey reaches stdout or stderr. And a token given with -k or --token leaves the
arguments of the process.   relight_terminal.py BIN"""
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

HELLO, LIST, PUT_BLOB, LOAD, INFO, ERROR, ANSWER = 1, 3, 4, 6, 10, 0xffff, 0x8000
NAME = 'bunny\x1b]0;owned\x07\x9b31m\x7f\r\nforged \u00e9'
SHOWN = 'bunny\\x1b]0;owned\\x07\\x9b31m\\x7f\\x0d\\x0aforged \u00e9'


def varint(x):
    out = b''
    while x >= 0x80:
        out += bytes([x & 0x7f | 0x80])
        x >>= 7
    return out + bytes([x])


def field(number, value):
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    value = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(value)) + value


def read(connection, n):
    data = b''
    while len(data) < n:
        part = connection.recv(n - len(data))
        if not part:
            raise EOFError
        data += part
    return data


MODEL = field(1, NAME) + field(2, NAME) + field(3, 6) + field(4, NAME)
MODEL += b''.join(field(n, NAME) for n in (18, 19, 20, 21)) + field(23, field(1, 19) + field(2, NAME))
MODEL += field(22, field(2, NAME))
ANSWERS = {
    HELLO: field(1, NAME) + field(2, 1) + field(3, 1 << 20) + field(4, 1 << 16) + field(5, 16) +
    field(6, 1 << 20) + field(8, 1 << 16),
    LIST: field(1, MODEL) + field(2, field(1, NAME) + field(2, 5)),
    INFO: MODEL,
}


def serve(listener):
    while True:
        connection, _ = listener.accept()
        put = [field(2, 1), field(2, 1 << 16)]  # the answers to PUT_BLOB; then it fails
        try:
            while True:
                head = read(connection, 32)
                kind, request = struct.unpack('<HQ', head[6:16])
                size, payload = struct.unpack('<I4xQ', head[16:])
                read(connection, size + (payload and payload + -(32 + size) % 64))
                body = ANSWERS.get(kind)
                if kind == PUT_BLOB and put:
                    body = put.pop(0)
                if body is None:
                    kind = ERROR
                    body = field(1, 5) + field(2, NAME + 'x' * 230 + '\u00e9' * 40) + field(3, NAME)
                else:
                    kind |= ANSWER
                connection.sendall(b'RLGT' + struct.pack('<BBHQIIQ', 1, 2, kind, request, len(body),
                                                         0, 0) + body)
        except (EOFError, OSError):
            connection.close()


def check(condition, text):
    if not condition:
        sys.exit('FAILED: ' + text)


def clean(data, text):
    for i, c in enumerate(data.decode()):  # raises when a character was cut
        check(c == '\n' or not (ord(c) < 32 or 0x7f <= ord(c) < 0xa0),
              '%s prints control character %#x at %d of %r' % (text, ord(c), i, data))


def run(relight, arguments):
    done = subprocess.run([relight] + arguments, capture_output=True, timeout=20, check=False)
    clean(done.stdout, 'relight ' + ' '.join(arguments))
    clean(done.stderr, 'relight ' + ' '.join(arguments))
    return done


def bar_is_cleared(relight, folder, server):
    """On a terminal an upload shows a bar, which is gone before the error."""
    path = os.path.join(folder, 'sky.hdr')
    with open(path, 'wb') as f:
        f.write(b'x' * 200000)
    master, slave = os.openpty()
    process = subprocess.Popen([relight] + server + ['env', path], stdin=subprocess.DEVNULL,
                               stdout=subprocess.DEVNULL, stderr=slave)
    os.close(slave)
    seen = b''
    try:
        while part := os.read(master, 4096):
            seen += part
    except OSError:  # EIO: the program has ended
        pass
    os.close(master)
    check(process.wait() == 1, 'an upload that fails')
    bar, _, error = seen.partition(b'relight: ')
    check(b'] ' in bar and b'% upload' in bar, 'no bar: %r' % seen)
    check(bar.endswith(b'\r\x1b[K') and b'owned' in error, 'the bar stays before the error: %r' % seen)


def arguments_of(pid):
    with open('/proc/%d/cmdline' % pid, 'rb') as f:
        return f.read()


def token_is_hidden(relight, folder, words):
    fifo = os.path.join(folder, 'fifo.json')
    if not os.path.exists(fifo):
        os.mkfifo(fifo)
    # The program stops where it opens the fifo, after it has parsed the token.
    process = subprocess.Popen([relight] + words + ['load', 'x', '--material', fifo],
                               stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 10
        seen = b''
        while b'fifo.json' not in seen or b'SECRET' in seen:
            check(time.monotonic() < end, 'arguments with %r stay %r' % (words, seen))
            time.sleep(0.02)
            seen = arguments_of(process.pid)
    finally:
        process.kill()
        process.wait()


def main():
    relight = os.path.join(sys.argv[1], 'relight')
    with tempfile.TemporaryDirectory() as folder:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(os.path.join(folder, 'daemon'))
        listener.listen(8)
        threading.Thread(target=serve, args=(listener,), daemon=True).start()
        server = ['-s', 'unix:' + os.path.join(folder, 'daemon')]
        models = run(relight, server + ['models', '--files'])
        check(models.returncode == 0, 'models: %r' % models.stderr)
        lines = models.stdout.decode().split('\n')
        check(len(lines) == 4 and all(SHOWN in line for line in lines[1:3]),
              'models does not escape the name: %r' % lines)
        info = run(relight, server + ['info', 'bunny'])
        check(info.returncode == 0, 'info: %r' % info.stderr)
        check(info.stdout.decode().count(SHOWN) >= 7, 'info does not escape: %r' % info.stdout)
        unload = run(relight, server + ['unload', 'bunny'])
        check(unload.returncode == 1 and b'bunny?]0;owned' in unload.stderr,
              'an error is printed: %r' % unload.stderr)
        bar_is_cleared(relight, folder, server)
        text = run(relight, server + ['models', '--json']).stdout.decode()
        check('\\u001b' in text, 'JSON keeps the name: %r' % text)
        if os.path.exists('/proc/self/cmdline'):
            for words in (['-k', 'SECRET'], ['--token', 'SECRET'], ['--token=SECRET'], ['-kSECRET'],
                          ['-k', 'SECRET1', '-k', 'SECRET2']):
                token_is_hidden(relight, folder, words)
    print('passed')


main()
