#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Includes point down: each room includes itself and the rooms below it.

   tests/unit/includes.py SOURCE_DIR

Every include that points up stands in EXCEPTIONS with its reason; one that is not needed any more
is an error, too."""
import os
import re
import sys

# Rooms of the server, and what each may include beside itself.
SERVER = {
    'core': set(),
    'net': {'core'},
    'store': {'core', 'net'},
    'jobs': {'core', 'net'},
    'render': {'core', 'net', 'store', 'jobs'},
    'ops': {'core', 'net', 'store', 'jobs', 'render'},
    'rooms': {'core', 'net', 'store', 'jobs', 'render'},
}
EXCEPTIONS = {
    # main starts and stops every room; server.h holds a pointer to each; stats.c prints them all.
    ('core/main.c', 'jobs'), ('core/main.c', 'net'), ('core/main.c', 'render'),
    ('core/main.c', 'store'), ('core/main.c', 'rooms'), ('core/server.h', 'jobs'), ('core/server.h', 'store'),
    ('core/main.c', 'ops'), ('core/stats.c', 'store'),
    # The operation table names materials; its waits open models and geometry.
    ('net/dispatch.c', 'render'), ('net/dispatch.c', 'store'), ('net/connection.c', 'render'),
    # A request waits for an entry of the cache.
    ('net/request_wait.h', 'store'),
    # The queue of bakes is written by the queue of file operations.
    ('jobs/job_store.c', 'store'),
    # One replica of those that share a folder bakes a model.
    ('jobs/runner_shared.c', 'store'),
    # A model's vertices may have moved.
    ('store/models.c', 'render'), ('store/model_open.c', 'render'),
}
# Rooms of libprt whose internal headers another room includes.
LIBPRT = {
    'base': set(), 'formats': set(),
    'texture': {'base'}, 'mesh': {'base', 'formats', 'texture'}, 'light': {'base'}, 'medium': {'base'},
    'media': {'base', 'mesh', 'medium'},
    'transport': {'base', 'texture', 'medium'}, 'trace': {'base', 'mesh'},
    'relight': {'base', 'transport', 'light', 'medium'},
    'reference': {'base', 'mesh', 'trace', 'light', 'medium'},
    'bake': {'base', 'mesh', 'trace', 'light', 'medium', 'transport', 'relight', 'reference'},
    'raster': {'base', 'texture', 'mesh', 'light', 'medium'},
    'screen': {'base', 'mesh', 'trace', 'light', 'medium', 'raster'},
    'tools': {'base', 'formats', 'texture', 'mesh', 'light', 'medium', 'media', 'transport', 'trace',
              'relight',
              'reference', 'bake', 'raster', 'screen'},
}
INCLUDE = re.compile(r'^#include "([a-z_]+)/[^"]+"', re.M)


def sources(folder):
    for root, _, names in os.walk(folder):
        for name in sorted(names):
            if name.endswith(('.c', '.h', '.cpp')):
                path = os.path.join(root, name)
                with open(path, encoding='utf-8') as f:
                    yield os.path.relpath(path, folder), f.read()


def main():
    os.chdir(sys.argv[1])
    errors, used, n = [], set(), 0
    for top, rooms in (('server', SERVER), ('libprt', LIBPRT)):
        for path, text in sources(top):
            room = path.split('/')[0]
            if room not in rooms:
                continue
            n += 1
            for to in set(INCLUDE.findall(text)) & set(rooms):
                if to == room or to in rooms[room]:
                    continue
                if top == 'server' and (path, to) in EXCEPTIONS:
                    used.add((path, to))
                else:
                    errors.append('%s/%s includes %s/, which lies above it' % (top, path, to))
    for top in ('client/lib', 'client/cli', 'proto'):
        for path, text in sources(top):
            n += 1
            if re.search(r'^#include "prt/', text, re.M):
                errors.append('%s/%s includes libprt' % (top, path))
    for path, to in sorted(EXCEPTIONS - used):
        errors.append('server/%s does not include %s/ any more: drop the exception' % (path, to))
    for error in sorted(errors):
        print('error: ' + error)
    print('%d files, %d includes that point up, each with a reason' % (n, len(used)))
    sys.exit(1 if errors else 0)


main()
