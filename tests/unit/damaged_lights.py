#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Environments with one fault each: prt names the fault, and reads the same file without it.

   tests/unit/damaged_lights.py PATH/TO/bin"""
import os
import struct
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from programs import expect, main, prt  # noqa: E402


def hdr(head='FORMAT=32-bit_rle_rgbe\n', size='-Y 4 +X 8', stored=8):
    """Four scanlines of eight pixels, each channel a run."""
    line = b'\x02\x02' + struct.pack('>H', stored) + b'\x88\x80' * 4
    return ('#?RADIANCE\n%s\n%s\n' % (head, size)).encode() + 4 * line


def dds(width=2, height=2, mips=1, caps=0xfe00, kind=113, data=None, size=124):
    """Six faces of RGBA16F."""
    head = struct.pack('<4s7I', b'DDS ', size, 0x2100f, height, width, 0, 0, mips)
    head += bytes(44) + struct.pack('<8I', 32, 4, kind, 0, 0, 0, 0, 0) + struct.pack('<5I', 0x1008, caps, 0, 0, 0)
    return head + (bytes(6 * 2 * 2 * 8 * 2) if data is None else data)


def ktx(width=2, height=2, faces=6, layers=0, order=0x04030201, gl_type=0x140b, gl_format=0x881a, data=None):
    """Six faces of RGBA16F."""
    head = b'\xabKTX 11\xbb\r\n\x1a\n' + struct.pack('<13I', order, gl_type, 2, 0x1908, gl_format, 0x1908, width, height,
                                                   0, layers, faces, 1, 0)
    face = width * height * 8
    return head + (struct.pack('<I', face) + bytes(6 * face) if data is None else data)


ROWS = (
    ('hdr', hdr(), None),
    ('hdr', hdr('FORMAT=32-bit_rle_xyze\n'), None),
    ('hdr', hdr('FORMAT=16-bit\n'), 'unknown format "16-bit"'),
    ('hdr', hdr('EXPOSURE=2\n'), None),
    ('hdr', hdr('EXPOSURE=0\n'), 'EXPOSURE must be a positive number, not "0"'),
    ('hdr', hdr('EXPOSURE=-1\n'), 'EXPOSURE must be a positive number, not "-1"'),
    ('hdr', hdr('EXPOSURE=\n'), 'EXPOSURE must be a positive number'),
    ('hdr', hdr(size='+Y 4 -X 8'), None),
    ('hdr', hdr(size='-Y 2 +Y 8'), 'no valid resolution line'),
    ('hdr', hdr(size='-Y 0 +X 8'), 'no valid resolution line ("-Y 0 +X 8")'),
    ('hdr', hdr(size='*Y 2 +X 8'), 'no valid resolution line'),
    ('hdr', hdr(size='-Y 2'), 'no valid resolution line'),
    ('hdr', hdr(size='-Y 2 +X 99999'), 'a side of 99999 pixels is above the limit'),
    ('hdr', hdr(stored=9), 'a scanline of 9 pixels in an image of 8'),
    ('dds', dds(), None),
    ('dds', dds(size=100), 'the file ends inside the DDS header'),
    ('dds', dds(caps=0xfc00), 'not a cubemap with six faces'),
    ('dds', dds(width=4), 'cube faces of 4 x 2 pixels; faces are squares'),
    ('dds', dds(width=4096, height=4096), 'cube faces of 4096 x 4096 pixels'),
    ('dds', dds(mips=12, data=bytes(720)), None),
    ('dds', dds(mips=13), '13 mip levels, at most 12'),
    ('dds', dds(data=bytes(6 * 32 - 1)), 'the file ends in the middle of the faces'),
    ('dds', dds(data=bytes(6 * 32)), None),
    ('ktx', ktx(), None),
    ('ktx', ktx(order=0x01020304), 'a big-endian KTX is not read'),
    ('ktx', ktx(width=4), 'cube faces of 4 x 2 pixels'),
    ('ktx', ktx(faces=1), 'a KTX of 1 faces and 0 layers'),
    ('ktx', ktx(layers=2), 'a KTX of 6 faces and 2 layers'),
    ('ktx', ktx(gl_type=0x1405), 'a KTX of type 0x1405'),
    ('ktx', ktx(data=struct.pack('<I', 32) + bytes(6 * 32 - 1)), 'the file ends in the middle of the faces'),
    ('ktx', ktx()[:60], 'the file ends inside the KTX header'),
)


def files():
    for i, (ending, data, fault) in enumerate(ROWS):
        name = '%d.%s' % (i, ending)
        with open(name, 'wb') as f:
            f.write(data)
        said = prt('info', name, status=1 if fault else 0).said
        expect(not fault or fault in said, '%s: no "%s" in: %s' % (name, fault, said))


def folders():
    """Six files: one missing, and a folder that is none."""
    os.mkdir('six')
    for face in ('posx', 'negx', 'posy', 'negy', 'posz'):
        with open('six/%s.hdr' % face, 'wb') as f:
            f.write(hdr())
    said = prt('info', 'six', status=1).said
    expect(said.count('error: ') == 1, 'one fault, one line: %s' % said)
    expect('no file for the negz face' in said, 'a face is missing: %s' % said)
    said = prt('info', 'none/px_*.hdr', status=1).said
    expect('cannot read the folder' in said, 'no folder: %s' % said)


main(files, folders)
