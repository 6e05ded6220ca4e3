#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Every list of picture formats in openapi.json has the words of relight.proto's ImageFormat, and
jpg for jpeg, and no others.

   tests/unit/openapi_formats.py SOURCE_DIR"""
import json
import re
import sys

PROTO = sys.argv[1] + '/proto/'


def lists(node):
    if isinstance(node, dict):
        if 'png16' in node.get('enum', ()):
            yield node['enum']
        for child in node.values():
            yield from lists(child)
    elif isinstance(node, list):
        for child in node:
            yield from lists(child)


def main():
    with open(PROTO + 'relight.proto', encoding='utf-8') as f:
        body = re.search(r'enum ImageFormat \{(.*?)\}', f.read(), re.S).group(1)
    words = {word.lower() for word in re.findall(r'^\s*IMAGE_(\w+) =', body, re.M)}
    with open(PROTO + 'openapi.json', encoding='utf-8') as f:
        found = list(lists(json.load(f)))
    wrong = [words ^ (set(own) - {'jpg'}) for own in found if set(own) - {'jpg'} != words]
    print('%d formats in %d lists' % (len(words), len(found)))
    if not found or wrong:
        sys.exit('openapi.json lists other formats than relight.proto: %r' % wrong)


main()
