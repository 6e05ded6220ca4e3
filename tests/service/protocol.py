#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A client written from PROTOCOL.md and relight.proto alone (no code of ours), over TCP, a unix
socket and WebSocket: what the document promises is what a live relightd does.  protocol.py BIN"""
import base64, hashlib, os, re, shutil, signal, socket, struct, subprocess, sys, tempfile, time

LAST, MORE, ANSWER, ERROR = 2, 1, 0x8000, 0xFFFF


def varint(n):
    out = b""
    while n > 127:
        out += bytes([n & 127 | 128])
        n >>= 7
    return out + bytes([n])


def pack(fields):
    """{number: int | str | bytes}: enough of protobuf's encoding for requests."""
    out = b""
    for number, value in fields.items():
        if isinstance(value, int):
            out += varint(number << 3) + varint(value)
        else:
            raw = value.encode() if isinstance(value, str) else value
            out += varint(number << 3 | 2) + varint(len(raw)) + raw
    return out


def unpack(data):
    """{number: [values]}; bytes for length-delimited fields."""
    at, out = 0, {}

    def number():
        nonlocal at
        n = shift = 0
        while True:
            byte = data[at]
            at += 1
            n |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return n

    while at < len(data):
        key = number()
        if key & 7 == 0:
            value = number()
        else:
            size = {1: 8, 5: 4}.get(key & 7) or number()
            value = data[at:at + size]
            at += size
        out.setdefault(key >> 3, []).append(value)
    return out


def frame(kind, ident, header=b"", payload=b"", flags=LAST, deadline=0):
    head = b"RLGT" + struct.pack("<BBHQIIQ", 1, flags, kind, ident, len(header), deadline, len(payload))
    out = head + header
    if payload:
        out += bytes(-len(out) % 64) + payload
    return out


class Stream:
    """TCP and unix sockets: frames one after another."""

    def __init__(self, address):
        if address.startswith("unix:"):
            self.socket = socket.socket(socket.AF_UNIX)
            self.socket.connect(address[5:])
        else:
            host, port = address[4:].rsplit(":", 1)
            self.socket = socket.create_connection((host, int(port)))
        self.socket.settimeout(20)

    def exactly(self, n):
        out = b""
        while len(out) < n:
            more = self.socket.recv(n - len(out))
            if not more:
                raise EOFError
            out += more
        return out

    def send(self, data):
        self.socket.sendall(data)

    def receive(self):
        fixed = self.exactly(32)
        magic, version, flags, kind, ident, n_header, deadline, n = struct.unpack("<4sBBHQIIQ", fixed)
        assert magic == b"RLGT" and version == 1 and flags & ~3 == 0 and deadline == 0
        header = self.exactly(n_header)
        if n:
            assert not any(self.exactly(-(32 + n_header) % 64))
        return kind, ident, flags, header, self.exactly(n)


class WebSocket(Stream):
    """The same frames, one a binary message."""

    def __init__(self, address):
        super().__init__("tcp:" + address)
        key = base64.b64encode(os.urandom(16))
        self.socket.sendall(b"GET /ws HTTP/1.1\r\nHost: " + address.encode() + b"\r\nUpgrade: websocket\r\n"
                            b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: "
                            b"relight.v1\r\nSec-WebSocket-Key: " + key + b"\r\n\r\n")
        answer = b""
        while not answer.endswith(b"\r\n\r\n"):
            answer += super().exactly(1)
        assert b" 101 " in answer.split(b"\r\n")[0], answer
        self.message = b""

    def send(self, data):
        n, mask = len(data), os.urandom(4)
        size = bytes([128 | n]) if n < 126 else b"\xfe" + struct.pack(">H", n) if n < 65536 else \
            b"\xff" + struct.pack(">Q", n)
        self.socket.sendall(b"\x82" + size + mask + bytes(b ^ mask[i & 3] for i, b in enumerate(data)))

    def exactly(self, n):
        out, self.message = self.message[:n], self.message[n:]
        assert len(out) == n, "a frame that goes beyond its message"
        return out

    def receive(self):
        assert not self.message, "a message with more than one frame"
        final = False
        while not final:
            first, size = Stream.exactly(self, 2)
            if size == 126:
                size, = struct.unpack(">H", Stream.exactly(self, 2))
            elif size == 127:
                size, = struct.unpack(">Q", Stream.exactly(self, 8))
            data = Stream.exactly(self, size)
            if first & 15 == 8:
                raise EOFError
            if first & 15 in (0, 2):
                self.message += data
                final = first & 128
        return super().receive()


class Client:
    def __init__(self, carrier):
        self.carrier, self.next = carrier, 1
        kind, header, _ = self.ask(1, {1: "protocol.py", 2: 1, 3: 1})
        assert kind == 1 | ANSWER
        self.hello = unpack(header)
        assert self.hello[2] == [1]

    def start(self, kind, fields, payload=b"", deadline=0):
        ident, self.next = self.next, self.next + 1
        self.carrier.send(frame(kind, ident, pack(fields), payload, LAST, deadline))
        return ident

    def ask(self, kind, fields, payload=b"", deadline=0):
        ident = self.start(kind, fields, payload, deadline)
        kind, got, flags, header, payload = self.carrier.receive()
        assert got == ident and flags & LAST, (kind, got, ident, flags)
        return kind, header, payload

    def refused(self, code, kind, fields, payload=b""):
        got, header, _ = self.ask(kind, fields, payload)
        assert got == ERROR, (kind, fields, got)
        fields = unpack(header)
        assert fields[1] == [code], fields
        assert fields[2][0] and b"\n" not in fields[2][0]


def sky():
    """A lat-long Radiance picture: 32 x 16, radiance (1, .5, .25) everywhere."""
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n" + bytes([128, 64, 32, 129]) * 512


def conversation(carrier):
    c = Client(carrier)
    assert c.hello[3][0] >= 1 << 16 and b"marble" in c.hello[7]
    # PING: the payload comes back; the fixed part alone is a frame too
    kind, _, payload = c.ask(2, {}, b"12345")
    assert kind == 2 | ANSWER and payload == b"12345"
    # PUT_BLOB: ask, send in chunks, ask again; a gap; a wrong hash
    blob = sky() + os.urandom(4)  # bytes behind the picture do no harm, and make it a new blob
    name = hashlib.sha256(blob).hexdigest()
    put = {1: name, 2: len(blob), 4: "sky.hdr"}
    kind, header, _ = c.ask(4, put)
    assert kind == 4 | ANSWER and unpack(header).get(1, [0]) == [0]
    c.refused(2, 4, {**put, 3: 2000}, blob[2000:])
    ids = [c.start(4, {**put, 3: at} if at else put, blob[at:at + 1000]) for at in range(0, len(blob), 1000)]
    for ident in ids:
        kind, got, _, header, _ = carrier.receive()
        assert kind == 4 | ANSWER and got in ids
    assert unpack(header) == {1: [1], 2: [len(blob)], 3: [name.encode()]}
    assert unpack(c.ask(4, put)[1])[1] == [1]
    c.refused(13, 4, {**put, 1: "0" * 64, 2: 4}, b"none")
    # ENV: decoded, described
    kind, header, _ = c.ask(5, {1: "env:" + name})
    env = unpack(header)
    assert kind == 5 | ANSWER and (env[3], env[4]) == ([32], [16]), env
    mean = [struct.unpack("<f", v[0])[0] for _, v in sorted(unpack(env[7][0]).items())]
    assert all(abs(m - w) < 0.02 * w for m, w in zip(mean, (1, .5, .25))), mean
    c.refused(5, 5, {1: "env:" + "0" * 64})
    # Errors that leave the connection alive: unknown type, header that does not parse, no model
    c.refused(14, 99, {})
    carrier.send(frame(10, 77, b"\xff\xff"))
    kind, got, _, header, _ = carrier.receive()
    assert (kind, got, unpack(header)[1]) == (ERROR, 77, [2])
    c.refused(5, 10, {1: "nothing"})
    c.refused(5, 12, {1: "nothing", 2: pack({1: "constant"})})
    # CANCEL of what is not there; LIST and STATS
    kind, header, _ = c.ask(9, {1: 12345})
    assert kind == 9 | ANSWER and unpack(header).get(1, [0]) == [0]
    assert c.ask(3, {})[0] == 3 | ANSWER
    assert unpack(c.ask(19, {})[1])[1]


def closes(open_carrier, data, hello, code):
    """The daemon answers with ERROR `code` under id 0 (or just closes), then closes."""
    carrier = open_carrier()
    if hello:
        Client(carrier)
    carrier.send(data)
    try:
        kind, ident, _, header, _ = carrier.receive()
        assert (kind, ident, unpack(header)[1]) == (ERROR, 0, [code]), (kind, ident, header)
        carrier.receive()
        raise AssertionError("the connection stayed open")
    except (EOFError, ConnectionError):
        pass


def hostile(open_carrier):
    good = frame(2, 5, b"", b"1234")
    for at, new in ((0, b"RLGX"), (4, b"\x02"), (5, b"\x04"), (5, b"\x08"), (16, b"\xff\xff\xff\x7f"),
                    (24, b"\xff" * 8), (40, b"\x01")):
        closes(open_carrier, good[:at] + new + good[at + len(new):], True, 1)
    closes(open_carrier, frame(2, 5, b"", b"1234", MORE), True, 1)  # requests are whole
    closes(open_carrier, good, False, 1)  # a payload before HELLO: its limit is 0
    c = Client(open_carrier())  # hints that nobody knows are ignored
    ident = c.next
    c.carrier.send(frame(2, ident, b"", b"1234", LAST | 0xf0))
    kind, got, _, _, payload = c.carrier.receive()
    assert (kind, got, payload) == (2 | ANSWER, ident, b"1234")
    carrier = open_carrier()
    carrier.send(frame(3, 1))
    kind, ident, _, header, _ = carrier.receive()
    assert (kind, ident, unpack(header)[1]) == (ERROR, 1, [4])


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as s:
        return s.getsockname()[1]


def main():
    folder = tempfile.mkdtemp()
    web = "127.0.0.1:%d" % free_port()
    log = open(folder + "/log", "wb")
    address = "unix:" + folder + "/s"
    daemon = subprocess.Popen([sys.argv[1] + "/relightd", "--data", folder + "/data", "--listen", address,
                               "--listen", "tcp:127.0.0.1:0", "--http", web], stderr=log)
    try:
        for _ in range(200):
            text = open(folder + "/log").read()
            if " start version" in text:
                break
            time.sleep(0.05)
        tcp = re.search(r"listen address=(tcp:\S+)", text).group(1)
        carriers = {"unix": lambda: Stream(address), "tcp": lambda: Stream(tcp), "ws": lambda: WebSocket(web)}
        for name, open_carrier in carriers.items():
            conversation(open_carrier())
            hostile(open_carrier)
            print(name, "as the document says")
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(20) == 0
        assert "Sanitizer: " not in open(folder + "/log").read()
    except BaseException:
        sys.stderr.write(open(folder + "/log").read()[-3000:])
        raise
    finally:
        daemon.kill()
        shutil.rmtree(folder, ignore_errors=True)


main()
