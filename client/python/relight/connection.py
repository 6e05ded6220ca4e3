# SPDX-License-Identifier: MIT
"""Frames over a socket (PROTOCOL.md, sections 1 and 2): requests by number, answers in any order."""
from __future__ import annotations

import os
import re
import socket
import ssl
import struct
import time
from collections import deque
from typing import Any, Deque, Dict, NamedTuple, Optional, Tuple

from .errors import RelightError
from .messages import message

MORE, LAST = 1, 2
ERROR, GOAWAY, ANSWER = 0xFFFF, 0xFFFE, 0x8000
FIXED = struct.Struct("<4sBBHQIIQ")
MOST_HEADER, MOST_PAYLOAD = 64 << 20, 1 << 32

# number and messages of each type
TYPES = {
    "HELLO": (1, "Hello"), "PING": (2, "Ping"), "LIST": (3, "List"), "PUT_BLOB": (4, "PutBlob"),
    "ENV": (5, "Env"), "LOAD": (6, "Load"), "WATCH": (7, "Watch"), "CANCEL_JOB": (8, "CancelJob"),
    "CANCEL": (9, "Cancel"), "INFO": (10, "Info"), "GEOMETRY": (11, "Geometry"),
    "COLORS": (12, "Colors"), "IMAGE": (13, "Image"), "VIEW_OPEN": (14, "ViewOpen"),
    "VIEW_SET": (15, "ViewSet"), "VIEW_CLOSE": (16, "ViewClose"), "UNLOAD": (18, "Unload"),
    "VIEW_ACK": (24, "ViewAck"), "FACTORS": (27, "Factors"), "SIGN": (35, "Sign"),
}
ANSWERS = {7: "Progress", 10: "ModelInfo", 14: "ViewFrame"}
NAMES = {number: ANSWERS.get(number, name + "Answer") for number, name in TYPES.values()}


class Frame(NamedTuple):
    message: Any
    payload: bytes
    last: bool


def default_address() -> str:
    """$RELIGHT_SERVER, else the unix socket of this user's daemon, else the port of this machine."""
    named = os.environ.get("RELIGHT_SERVER")
    local = os.path.join(os.environ.get("XDG_RUNTIME_DIR", "/nonexistent"), "relightd.sock")
    return named or ("unix:" + local if os.path.exists(local) else "tcp:127.0.0.1:7413")


def split_host(text: str) -> Optional[Tuple[str, int]]:
    """HOST, HOST:PORT, [V6] or [V6]:PORT."""
    found = re.fullmatch(r"(?:\[([^\]]+)\]|([^\[:][^:]*))(?::([0-9]{1,5}))?", text)
    if not found or int(found[3] or 0) > 65535:
        return None
    return found[1] or found[2], int(found[3] or 7413)


def connect(address: str, ca: Optional[str], timeout: Optional[float]) -> socket.socket:
    kind, _, rest = address.partition(":")
    place = split_host(rest) if kind in ("tcp", "tls") else None
    if not place and (kind != "unix" or not rest):
        raise RelightError("ARGUMENT", "%s: expected tcp:HOST[:PORT], tls:HOST[:PORT] or unix:PATH" % address,
                           "an IPv6 address is written in brackets: tcp:[::1]:7413"
                           if kind in ("tcp", "tls") else "")
    try:
        if not place:
            unix = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            unix.settimeout(timeout)
            unix.connect(rest)
            return unix
        plain = socket.create_connection(place, timeout or 5)
        plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if kind == "tcp":
            return plain
        return ssl.create_default_context(cafile=ca).wrap_socket(plain, server_hostname=place[0])
    except OSError as fault:
        raise RelightError("UNREACHABLE", "%s: %s" % (address, fault)) from fault
    except ValueError as fault:  # a name that no host can have
        raise RelightError("ARGUMENT", "%r: %s" % (address, fault)) from fault


class Connection:
    """One thread at a time."""

    def __init__(self, address: str, ca: Optional[str], timeout: Optional[float]) -> None:
        self._socket = connect(address, ca, timeout)
        self._last = 0
        self._waiting: Dict[int, Deque[Frame]] = {}
        self._parts: Dict[int, Any] = {}
        self._begun = b""  # the beginning of a frame, where its rest did not come in time
        self.broken = False

    def close(self) -> None:
        self.broken = True
        self._socket.close()

    def send(self, kind: str, request: Any, payload: bytes = b"", timeout: Optional[float] = None,
             one_way: bool = False) -> int:
        """Sends a request; its number, to be waited for. one_way: nothing answers."""
        number = TYPES[kind][0]
        header = request.SerializeToString()
        if not one_way:
            self._last += 1
            self._waiting[self._last] = deque()
        pad = -(FIXED.size + len(header)) % 64 if payload else 0
        deadline = min(int(timeout * 1000) + 1, 0xFFFFFFFF) if timeout and not one_way else 0
        fixed = FIXED.pack(b"RLGT", 1, LAST, number, 0 if one_way else self._last, len(header), deadline,
                           len(payload))
        try:
            self._socket.settimeout(None)
            self._socket.sendall(fixed + header + bytes(pad) + payload)
        except OSError as fault:
            self.close()
            raise RelightError("DISCONNECTED", "the connection was lost: %s" % fault) from fault
        return self._last

    def _read(self, n: int, end: Optional[float]) -> bytearray:
        out = bytearray(n)
        out[:len(self._begun)] = self._begun
        at = memoryview(out)[len(self._begun):]
        self._begun = b""
        while at:
            left = None if end is None else end - time.monotonic()
            try:
                if left is not None and left <= 0:
                    raise TimeoutError
                self._socket.settimeout(left)
                got = self._socket.recv_into(at)
            except TimeoutError:
                self._begun = bytes(out[:n - len(at)])
                raise
            except OSError as fault:
                self.close()
                raise RelightError("DISCONNECTED", "the connection was lost: %s" % fault) from fault
            if not got:
                self.close()
                raise RelightError("DISCONNECTED", "the daemon closed the connection")
            at = at[got:]
        return out

    def _fail(self, why: str) -> RelightError:
        self.close()
        return RelightError("PROTOCOL", why)

    def _take(self, end: Optional[float]) -> None:
        """Reads one frame. A time-out between frames, or in a fixed part, leaves the connection usable."""
        fixed = self._read(FIXED.size, end)
        # The rest of a frame that began is waited for: half a frame cannot be given back.
        magic, version, flags, kind, number, n_header, _, n_payload = FIXED.unpack(fixed)
        if magic != b"RLGT" or version != 1 or n_header > MOST_HEADER or n_payload > MOST_PAYLOAD:
            raise self._fail("the server's frame makes no sense")
        header = bytes(self._read(n_header, None))
        if n_payload:
            self._read(-(FIXED.size + n_header) % 64, None)
        payload = self._read(n_payload, None)
        if number in self._parts:
            first, parts = self._parts[number]
            parts.append(payload)
            if flags & MORE:
                return
            del self._parts[number]
            self._give(number, first._replace(payload=b"".join(parts), last=bool(flags & LAST)))
            return
        name = "Error" if kind == ERROR else "Goaway" if kind == GOAWAY else NAMES.get(kind & ~ANSWER)
        if name is None:
            return
        answer = message(name)
        try:
            answer.ParseFromString(header)
        except Exception as fault:
            raise self._fail("an answer does not parse: %s" % fault) from fault
        if kind == ERROR and not number:
            self.close()
            raise RelightError.of_message(answer)
        frame = Frame(answer, bytes(payload), bool(flags & LAST))
        if flags & MORE:
            self._parts[number] = (frame, [payload])
        else:
            self._give(number, frame)

    def _give(self, number: int, frame: Frame) -> None:
        if number in self._waiting:
            self._waiting[number].append(frame)

    def pending(self, number: int) -> bool:
        """Whether an answer is here that was not taken yet."""
        return bool(self._waiting.get(number))

    def forget(self, number: int) -> None:
        self._waiting.pop(number, None)

    def next(self, number: int, timeout: Optional[float]) -> Frame:
        """The next answer of a request. TimeoutError where none comes in time."""
        end = None if timeout is None else time.monotonic() + timeout
        while not self._waiting[number]:
            if self.broken:
                raise RelightError("DISCONNECTED", "the connection is closed")
            self._take(end)
        frame = self._waiting[number].popleft()
        if frame.last:
            self.forget(number)
        if frame.message.DESCRIPTOR.name == "Error":
            self.forget(number)
            raise RelightError.of_message(frame.message)
        return frame
