#!/bin/sh
# SPDX-License-Identifier: MIT
# Every C and C++ file is as .clang-format says. Versions of clang-format differ in details, so only
# the one the tree was formatted with decides; without it the test says that it skips.
#   tests/unit/format.sh SOURCE_DIR
set -eu
cd "$1"
for tool in clang-format-14 clang-format; do
    if command -v $tool >/dev/null && $tool --version | grep -q ' version 14\.'; then
        found=$tool
        break
    fi
done
if [ -z "${found:-}" ]; then
    echo "skipped: no clang-format 14 here (Debian 12: apt-get install clang-format)"
    exit 77
fi
if [ -d .git ] || [ -f .git ]; then
    files=$(git ls-files -co --exclude-standard '*.c' '*.h' '*.cpp')
else
    files=$(find client libprt proto server tests -name '*.[ch]' -o -name '*.cpp')
fi
bad=$(echo "$files" | xargs "$found" --dry-run 2>&1 | sed -n 's/^\([^:]*\):[0-9]*:.*/\1/p' | sort -u)
if [ -n "$bad" ]; then
    echo "not formatted; run: $found -i" $bad >&2
    exit 1
fi
echo "$(echo "$files" | wc -l) files as .clang-format says"
