#!/bin/sh
# SPDX-License-Identifier: MIT
# External symbols carry their library's prefix: prt_ in libprt, relight_ in librelight, so that a
# program that links both has its own names for itself.
#   symbols.sh BUILD_FOLDER
set -eu
command -v nm >/dev/null || { echo "SKIPPED: nm is not installed"; exit 77; }
bad=0
# foreign PREFIX ARCHIVE...: external C symbols that do not begin with the prefix.
foreign() {
    prefix=$1
    shift
    for archive in "$@"; do
        nm -g --defined-only "$archive" 2>/dev/null |
            awk -v a="$archive" -v p="^($prefix|_Z|__|DW\\\\.)" '
                /^[^ ]+\.o:$/ { object = $0 }
                $2 ~ /^[TDBRC]$/ && $3 !~ p { print "error: " a ", " object " " $3 }'
    done
}
for line in "$(foreign prt_ "$1"/libprt/libprt*.a)" "$(foreign relight_ "$1"/client/librelight.a)"; do
    [ -z "$line" ] || { echo "$line"; bad=1; }
done
exit $bad
