#!/bin/sh
# SPDX-License-Identifier: MIT
# What `cmake --install` lays down works from there: programs, library, header, pkg-config file,
# service unit, configuration, man pages. CMAKE BUILD SOURCE CC SANITIZERS
set -eu
cmake=$1 build=$2 source=$3 cc=$4 sanitize=${5-}
tmp=$(mktemp -d) && trap 'rm -rf "$tmp"' EXIT
fail() { echo "install.sh: $*" >&2; exit 1; }
# The absolute folder of configuration follows DESTDIR only.
DESTDIR=$tmp "$cmake" --install "$build" >"$tmp/log" 2>&1 || { cat "$tmp/log" >&2; fail "cmake --install failed"; }
bin=$(dirname "$(find "$tmp" -name relightd -type f)")
prefix=$(dirname "$bin")
for program in prt relight relightd relight-preview prt-bench; do
    [ -x "$bin/$program" ] || fail "$program is not installed"
done
"$bin/prt" --version >/dev/null
"$bin/relight" --version >/dev/null
conf=$(find "$tmp" -name relightd.conf)
"$bin/relightd" --config "$conf" --print-config >"$tmp/default" || fail "relightd.conf is refused"
# It names every option there is, with the defaults that --print-config shows.
sed -n 's/^#\([a-z-]*\) =.*/\1/p' "$tmp/default" | sort -u >"$tmp/words"
sed -n 's/^#\{0,1\}\([a-z-]*\) =.*/\1/p' "$conf" | sort -u >"$tmp/named"
diff "$tmp/words" "$tmp/named" >&2 || fail "relightd.conf and --print-config name different options"
unit=$(find "$tmp" -name relightd.service)
grep -q '^ExecStart=/.*/relightd --config /.*/relightd.conf$' "$unit" || fail "the unit's ExecStart"
for file in sysusers.d tmpfiles.d; do
    [ -s "$prefix/lib/$file/relight.conf" ] || fail "no $file/relight.conf"
done
grep -q '^models = ' "$conf" && ! grep -q '^models = /var/lib/relight' "$conf" ||
    fail "relightd.conf: the models folder lies in the data folder"
if command -v systemd-analyze >/dev/null; then
    sed "s#^ExecStart=[^ ]*#ExecStart=$bin/relightd#" "$unit" >"$tmp/relightd.service"
    systemd-analyze verify --man=no --generators=no --recursive-errors=no "$tmp/relightd.service" \
        >"$tmp/verify" 2>&1 && [ ! -s "$tmp/verify" ] ||
        { cat "$tmp/verify" >&2; fail "systemd-analyze finds faults in the unit"; }
fi
for page in man1/prt.1 man1/prt-bake.1 man1/relight.1 man8/relightd.8; do
    [ -s "$prefix/share/man/$page" ] || fail "no $page"
done
# Exactly what the header declares is visible.
lib=$(find "$tmp" -name librelight.so)
sed -n 's/^[a-z].*[ *]\(relight_[a-z0-9_]*\)(.*/\1/p' "$prefix/include/relight/relight.h" |
    sort -u >"$tmp/declared"
nm -D --defined-only "$lib" | awk '$2 == "T" { print $3 }' | sort -u >"$tmp/visible"
diff "$tmp/declared" "$tmp/visible" >&2 || fail "header and librelight.so differ"
[ -z "$sanitize" ] || exit 0
command -v pkg-config >/dev/null || exit 0
cat >"$tmp/own.c" <<'C'
#include <relight/relight.h>
#include <stdio.h>
int main(void)
{
    struct relight_client *client;
    struct relight_error error;
    int status = relight_connect("unix:/nowhere/at/all", NULL, &client, &error);
    return status == -RELIGHT_E_UNREACHABLE && puts(relight_code_text(status)) >= 0 ? 0 : 1;
}
C
export PKG_CONFIG_PATH="$(dirname "$(find "$tmp" -name relight.pc)")"
export PKG_CONFIG_SYSROOT_DIR="$tmp"
# shellcheck disable=SC2046 # flags
"$cc" -o "$tmp/own" "$tmp/own.c" $(pkg-config --cflags --libs relight)
LD_LIBRARY_PATH=$(dirname "$lib") "$tmp/own" >/dev/null || fail "a program of one's own does not run"
