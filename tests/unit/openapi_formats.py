#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Every list of picture formats in openapi.json has the words of relight.proto's ImageFormat, and
jpg for jpeg, and no others; every list of endings in a path those of relight.h, and jpeg.

   tests/unit/openapi_formats.py SOURCE_DIR"""
import json
import re
import sys

PROTO = sys.argv[1] + '/proto/'


def lists(node, word, without=''):
    if isinstance(node, dict):
        if word in node.get('enum', ()) and without not in node['enum']:
            yield node['enum']
        for child in node.values():
            yield from lists(child, word, without)
    elif isinstance(node, list):
        for child in node:
            yield from lists(child, word, without)


def main():
    with open(PROTO + 'relight.proto', encoding='utf-8') as f:
        body = re.search(r'enum ImageFormat \{(.*?)\}', f.read(), re.S).group(1)
    words = {word.lower() for word in re.findall(r'^\s*IMAGE_(\w+) =', body, re.M)}
    with open(PROTO + '../client/include/relight/relight.h', encoding='utf-8') as f:
        rows = re.search(r'define RELIGHT_IMAGE_FORMAT_LIST\(X\)((?:.*\\\n)*.*)', f.read()).group(1)
    endings = set(re.findall(r'X\(\w+, \d+, "(\w+)"\)', rows)) | {'jpeg'}
    with open(PROTO + 'openapi.json', encoding='utf-8') as f:
        api = json.load(f)
    found, paths = list(lists(api, 'png16')), list(lists(api, 'jpeg', 'png16'))
    wrong = [words ^ (set(own) - {'jpg'}) for own in found if set(own) - {'jpg'} != words]
    print('%d formats in %d lists' % (len(words), len(found)))
    if not found or wrong:
        sys.exit('openapi.json lists other formats than relight.proto: %r' % wrong)
    print('%d endings in %d lists' % (len(endings), len(paths)))
    wrong = [endings ^ set(own) for own in paths if endings != set(own)]
    if not paths or wrong:
        sys.exit('openapi.json lists other endings than relight.h: %r' % wrong)


main()
