#!/bin/sh
# SPDX-License-Identifier: MIT
# The relight program without a daemon: exit statuses, help, what it links. BIN CC CXX SOURCE
set -u
bin=$1 cc=$2 cxx=$3 source=$4
tmp=$(mktemp -d) && trap 'rm -rf "$tmp"' EXIT
failed=0
fail() {
    echo "FAILED: $*" >&2
    failed=1
}
# status WANTED TEXT-ON-STDERR ARGUMENTS...
status() {
    wanted=$1 text=$2
    shift 2
    "$bin/relight" "$@" >"$tmp/out" 2>"$tmp/err"
    got=$?
    [ $got = "$wanted" ] || fail "relight $*: status $got, wanted $wanted: $(cat "$tmp/err")"
    [ -z "$text" ] || grep -q -- "$text" "$tmp/err" || fail "relight $*: no '$text' in: $(cat "$tmp/err")"
}
unset RELIGHT_SERVER XDG_RUNTIME_DIR
nowhere=unix:$tmp/nowhere.sock

status 3 "No such file" -s "$nowhere" ping
status 3 "start the daemon" -s tcp:127.0.0.1:1 ping
RELIGHT_SERVER=$nowhere status 3 "nowhere.sock" ping
status 2 "no command" -s "$nowhere"
status 2 "unknown command" frobnicate
status 2 "ID is missing" -s "$nowhere" info
status 2 "too many" -s "$nowhere" info a b
status 2 "expected tcp:HOST:PORT" -s http://x ping
status 2 "expected one of total" colors x --env constant --term foo -o x.csv
status 2 "each in" image x --env constant --size 0x10 -o x.png
status 2 "each in" image x --env constant --size 5000x10 -o x.png
status 2 "each in" image x --env constant --size 4294967297x10 -o x.png
status 2 "leave its --env out" image x --env constant --gain 0 -o x.png
status 2 "leave its --env out" image x --env constant --gain 0,0,0 -o x.png
status 2 "camera" image x --env constant --camera 1,2 -o x.png
status 2 "in \[0.001, 1e+06\]" load x --size-mm -4
status 2 "in \[0.001, 1e+06\]" load x --size-mm nan
status 2 "in \[1, 100\]" image x --env constant --quality 101 -o x.jpg
status 2 "whole number" load x --cube big
status 2 "whole number" load x --rank -1
# A year has 31536000 seconds.
status 3 "nowhere.sock" -s "$nowhere" sign /v1 --expires 31536000s
status 2 "such as 30d" -s "$nowhere" sign /v1 --expires 1e9w
status 2 "such as 30d" -s "$nowhere" sign /v1 --expires 0.5s
status 2 "unrecognized option" ping --env constant
status 1 "No such file" load x --material "$tmp/none.json"
echo '[1,2]' >"$tmp/bad.json"
status 1 "not a material" load x --material "$tmp/bad.json"
status 0 "" --help
status 0 "" --version

for command in ping models load info watch cancel env colors image edit geometry unload token stats; do
    "$bin/relight" --help | grep -q "^  $command" || fail "$command is not in --help"
    "$bin/relight" $command --help | grep -q "Example" || fail "$command --help has no example"
done

# The thin client stays thin, and progress stays off pipes.
if command -v ldd >/dev/null; then
    ldd "$bin/relight" | grep -E -i 'embree|libGL|OSMesa|OpenEXR|OpenImageIO|tinygltf|blas' &&
        fail "relight links a library that it must not"
fi

# The public headers stand alone, in C and in C++.
for header in client/include/relight/relight.h proto/frame.h; do
    "$cc" -std=gnu11 -Wall -Wextra -Werror -fsyntax-only -x c "$source/$header" ||
        fail "$header does not compile alone as C"
    "$cxx" -Wall -Wextra -Werror -fsyntax-only -x c++ "$source/$header" ||
        fail "$header does not compile alone as C++"
done
exit $failed
