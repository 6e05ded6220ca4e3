#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Lines of PROTOCOL.md have at most 140 characters. Its table has every type of frame.h with its number
and messages, and the scope that the type's row in dispatch.h asks for.
tests/unit/protocol_lines.py SOURCE_DIR"""
import re
import sys

AGAIN = ('–', 'safe', 'same', 'done', 'see §3')


def read(name):
    return open('%s/%s' % (sys.argv[1], name), encoding='utf-8').read()


def camel(message):
    return ''.join(word.capitalize() for word in message.split('_'))


def scopes():
    """The scope of each message, as PROTOCOL.md writes it."""
    lists = read('server/net/dispatch.h').replace('\\\n', ' ')
    rows = re.findall(r'X\((\w+),\s+\w+,\s+[\w |]+,\s+(\w+),', lists)
    one_way = re.findall(r'X\((\w+),\s+\w+,\s+[\w |]+\)', lists)
    needs = {message: '–' if scope == '0' else '`%s`' % scope.lower() for message, scope in rows}
    return {**needs, **{message: '–' for message in one_way}}


def faults_of_row(name, request, answer, scope, row):
    if camel(request) not in row[3] or answer != 'nothing' and camel(answer) not in row[3]:
        yield '%s: its messages are %s and %s' % (name, camel(request), camel(answer))
    if not row[6].startswith(scope):
        yield '%s needs the scope %s, the table says %s' % (name, scope, row[6])
    if row[7] not in AGAIN:
        yield '%s: the column "again" is %s, not one of %s' % (name, row[7], ', '.join(AGAIN))


text = read('proto/PROTOCOL.md')
errors = ['proto/PROTOCOL.md: line %d has %d characters' % (i, len(line))
          for i, line in enumerate(text.splitlines(), 1) if len(line) > 140]
rows = [[cell.strip() for cell in line.split('|')] for line in text.splitlines() if line.startswith('| ')]
table = {(row[1], row[2]): row for row in rows if len(row) == 9}
types = re.findall(r'X\((\w+), (\d+), (\w+), (\w+)\)', read('proto/frame.h'))
needs = scopes()
for name, number, request, answer in types:
    row = table.get((number, name))
    if request not in needs:
        errors.append('server/net/dispatch.h: %s: OPERATION_LIST has no line X(%s, …)' % (name, request))
    if not row:
        errors.append('proto/PROTOCOL.md: type %s, %s, is not in the table' % (number, name))
    elif request in needs:
        errors += ['proto/PROTOCOL.md: ' + fault
                   for fault in faults_of_row(name, request, answer, needs[request], row)]
for error in errors:
    print('error: ' + error)
print('%d lines, %d types, %d scopes' % (len(text.splitlines()), len(types), len(needs)))
sys.exit(1 if errors or len(types) < 20 else 0)
