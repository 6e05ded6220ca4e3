#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A relightd behind a proxy (--proxies): HTTP, WebSocket and TCP see the client that the PROXY
header names; without a header, and for those who are no proxy, nothing is served.

   proxy.py FOLDER_OF_THE_PROGRAMS"""
import base64
import os
import re
import socket
import struct
import sys
import time

from web import Daemon

SIGNATURE = b"\r\n\r\n\0\r\nQUIT\n"


def header(client="192.0.2.7", port=40312, command=1):
    addresses = socket.inet_aton(client) + socket.inet_aton("10.0.0.1") + struct.pack(">HH", port, 80)
    return SIGNATURE + bytes([0x20 | command, 0x11]) + struct.pack(">H", len(addresses)) + addresses


def talk(port, *pieces, source="127.0.0.1", until=None):
    """What the daemon says until it closes, or until these bytes have come."""
    s = socket.create_connection(("127.0.0.1", port), 5, (source, 0))
    try:
        for piece in pieces:
            s.sendall(piece)
            time.sleep(0.003)
        s.settimeout(60)
        got = b""
        while True:
            more = s.recv(65536)
            if not more:
                return got
            got += more
            if until and until in got:
                return got
    except ConnectionError:
        return got
    finally:
        s.close()


GET = b"GET /readyz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"


def main():
    d = Daemon(sys.argv[1], "--proxies", "127.0.0.9", "--listen", "tcp:127.0.0.1:0", "--handshake", "4")
    try:
        tcp = int(re.search(r"tcp:127.0.0.1:(\d+)", d.log()).group(1))
        # HTTP: the header at once, or byte by byte; a health check of the proxy itself.
        assert b"200 OK" in talk(d.port, header() + GET, source="127.0.0.9")
        assert b"200 OK" in talk(d.port, *[bytes([b]) for b in header()], GET, source="127.0.0.9")
        assert b"200 OK" in talk(d.port, SIGNATURE + b"\x20\0\0\0" + GET, source="127.0.0.9")
        # Of the proxy without a header nothing is taken, nor a header of somebody else.
        assert talk(d.port, GET, source="127.0.0.9") == b""
        assert talk(d.port, b"", source="127.0.0.9") == b"", "it waits longer than --handshake"
        assert b"200 OK" not in talk(d.port, header() + GET)
        assert b"200 OK" in talk(d.port, GET)
        assert talk(d.port, header()[:12] + b"\x22" + b"\xff" * 40, source="127.0.0.9") == b""
        # WebSocket on a model's path, and TCP: the log names the client behind the proxy.
        key = base64.b64encode(os.urandom(16))
        upgrade = (b"GET /ws/0123456789abcdef HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
                   b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: relight.v1\r\n"
                   b"Sec-WebSocket-Key: " + key + b"\r\n\r\n")
        assert b" 101 " in talk(d.port, header("192.0.2.8", 1234), upgrade, source="127.0.0.9", until=b"\r\n\r\n")
        assert b" 101 " not in talk(d.port, upgrade.replace(b"/ws/0123456789abcdef", b"/wsx"), until=b"\r\n\r\n")
        d.wait_log("carrier=websocket peer=192.0.2.8:1234")
        talk(tcp, header("192.0.2.9", 4321), source="127.0.0.9")  # silent, it is closed by --handshake
        d.wait_log("carrier=tcp peer=192.0.2.9:4321")
        # Who comes directly on a descriptor that a proxied client had is nobody but itself.
        before = d.log().count("event disconnect")
        assert b" 101 " in talk(d.port, header("192.0.2.10", 77), upgrade, source="127.0.0.9", until=b"\r\n\r\n")
        while d.log().count("event disconnect") == before:
            time.sleep(0.01)
        assert b" 101 " in talk(d.port, upgrade, until=b"\r\n\r\n")
        d.wait_log("carrier=websocket peer=127.0.0.1:")
        print("the client behind the proxy is known on every carrier")
    finally:
        d.stop()


main()
