#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Lines of PROTOCOL.md have at most 140 characters, and its table names every type of frame.h with
its number.  tests/unit/protocol_lines.py SOURCE_DIR"""
import re
import sys

source = sys.argv[1]
text = open(source + '/proto/PROTOCOL.md', encoding='utf-8').read()
header = open(source + '/proto/frame.h', encoding='utf-8').read()
errors = ['line %d has %d characters' % (i, len(line))
          for i, line in enumerate(text.splitlines(), 1) if len(line) > 140]
types = re.findall(r'X\(([A-Z_]+), (\d+), [a-z_]+, [a-z_]+\)', header)
for name, number in types:
    if '| %s | %s |' % (number, name) not in text:
        errors.append('type %s, %s, is not in the table' % (number, name))
for error in errors:
    print('error: PROTOCOL.md: ' + error)
print('%d lines, %d types' % (len(text.splitlines()), len(types)))
sys.exit(1 if errors or len(types) < 20 else 0)
