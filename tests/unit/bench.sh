#!/bin/sh
# SPDX-License-Identifier: MIT
# prt-bench: its list, its JSON lines, its refusals.
set -eu
bench=$1
fail() { echo "bench.sh: $*" >&2; exit 1; }
"$bench" --list | grep -q '^relight_factored ' || fail "--list does not name relight_factored"
names='bandwidth cold_start relight_factored relight_joint relight_phase relight_polynomial relight_sparse'
out=$("$bench" --quick $names)
echo "$out"
[ "$(echo "$out" | wc -l)" -ge 15 ] || fail "too few figures"
if echo "$out" | grep -v '^{"bench": "[a-z0-9_]*", "cpu": "[a-z0-9]*", "threads": [0-9]*\(, "[A-Za-z0-9_]*": \("[^"]*"\|null\|-\{0,1\}[0-9.e+-]*\)\)*}$'; then
    fail "a line is not the JSON it should be"
fi
echo "$out" | grep -q '"factored_million_8_lights".*"times_one": [0-9]' || fail "no ratio of 8 lights"
code=0; "$bench" no_such_figure 2>/dev/null || code=$?
[ $code = 2 ] || fail "an unknown name exits $code"
code=0; "$bench" --file /nowhere.prt relight_file 2>/dev/null || code=$?
[ $code = 1 ] || fail "a missing file exits $code"
code=0; "$bench" --cpu mmx 2>/dev/null || code=$?
[ $code = 2 ] || fail "an unknown --cpu exits $code"
