#!/bin/sh
# SPDX-License-Identifier: MIT
# What `cmake --install` lays down works from there: programs, library, header, pkg-config file,
# service unit, configuration, man pages. CMAKE BUILD SOURCE CC SANITIZERS
set -eu
cmake=$1 build=$2 source=$3 cc=$4 sanitize=${5-}
tmp=$(mktemp -d) && trap 'rm -rf "$tmp"' EXIT
fail() { echo "install.sh: $*" >&2; exit 1; }
# The build is configured for /usr/local, as it comes; files that name folders name those of this prefix.
DESTDIR=$tmp "$cmake" --install "$build" --prefix /usr >"$tmp/log" 2>&1 || { cat "$tmp/log" >&2; fail "cmake --install failed"; }
bin=$(dirname "$(find "$tmp" -name relightd -type f)")
prefix=$(dirname "$bin")
for program in prt relight relightd relight-preview relight-control prt-bench; do
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
[ "$conf" = "$tmp/etc/relight/relightd.conf" ] || fail "relightd.conf is installed as $conf"
for file in "$unit:relightd.conf" "$prefix/lib/systemd/system/relightd@.service:%i.conf"; do
    grep -qx "ExecStart=/usr/bin/relightd --config /etc/relight/${file##*:}" "${file%:*}" || fail "ExecStart of ${file%:*}"
done
rules=$prefix/lib/udev/rules.d/60-relight-control.rules
grep -q 'ATTR{idVendor}=="046d", ATTR{idProduct}=="c626"' "$rules" || fail "no rule for the SpaceNavigator"
# Each device that relight-control knows has its rule, and no other has one.
sed -n 's/^ *{0x\([0-9a-f]*\), 0x\([0-9a-f]*\), KNOWN_.*/\1:\2/p' "$source/client/controller/known.c" | sort >"$tmp/known"
sed -n 's/.*idVendor}=="\([0-9a-f]*\)", ATTR{idProduct}=="\([0-9a-f]*\)".*/\1:\2/p' "$rules" | sort >"$tmp/ruled"
diff "$tmp/known" "$tmp/ruled" >&2 || fail "known.c and the udev rules name different devices"
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
for page in man1/prt.1 man1/prt-bake.1 man1/prt-material.1 man1/prt-bench.1 man1/relight.1 man1/relight-control.1 man8/relightd.8 man5/relightd.conf.5 man3/relight.3; do
    [ -s "$prefix/share/man/$page" ] || fail "no $page"
done
# An example is copied as it stands: argp breaks lines of more than 79 characters.
for page in "$prefix"/share/man/man1/*.1; do
    if sed -n '/^Examples*:/,/^$/p' "$page" | sed '1d; /^$/d; /^\.fi$/d' | grep -v '^  ' >&2; then
        fail "$(basename "$page"): an example's line is broken"
    fi
done
# A page of section 3 for each function that the header declares, with its name and its outcome.
sed -n 's/^[a-z].*[ *]\(relight_[a-z0-9_]*\)(.*/\1/p' "$prefix/include/relight/relight.h" |
    while read -r name; do
        page=$prefix/share/man/man3/$name.3
        grep -q "^$name .- " "$page" || fail "$page names nothing"
        grep -q "Thread.-safety: " "$page" || grep -q "; as " "$page" || fail "$page lacks its attributes"
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
grep -qx prefix=/usr "$(find "$tmp" -name relight.pc)" || fail "relight.pc names another prefix"
export PKG_CONFIG_PATH="$(dirname "$(find "$tmp" -name relight.pc)")"
export PKG_CONFIG_SYSROOT_DIR="$tmp"
# shellcheck disable=SC2046 # flags
"$cc" -o "$tmp/own" "$tmp/own.c" $(pkg-config --cflags --libs relight)
LD_LIBRARY_PATH=$(dirname "$lib") "$tmp/own" >/dev/null || fail "a program of one's own does not run"

# The example uploads a model, has it baked, and writes a picture. The bake is made small.
example=$(find "$tmp" -name relight_model.c)
[ -n "$example" ] || fail "the example is not installed"
# shellcheck disable=SC2046 # flags
"$cc" -Wall -Wextra -Werror -o "$tmp/relight_model" "$example" $(pkg-config --cflags --libs relight)
printf '#!/bin/sh\nexec "%s/prt" "$@" --samples=2000 --cube=16 --no-single\n' "$bin" >"$tmp/prt"
chmod +x "$tmp/prt"
cat >"$tmp/box.obj" <<'OBJ'
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
OBJ
"$bin/relightd" --listen "unix:$tmp/socket" --prt "$tmp/prt" 2>"$tmp/relightd.log" &
daemon=$!
trap 'kill $daemon 2>/dev/null; wait $daemon 2>/dev/null; rm -rf "$tmp"' EXIT
for _ in $(seq 600); do [ ! -S "$tmp/socket" ] || break; sleep 0.1; done
RELIGHT_SERVER="unix:$tmp/socket" LD_LIBRARY_PATH=$(dirname "$lib") \
    "$tmp/relight_model" "$tmp/box.obj" 10 marble constant "$tmp/box.png" 2>"$tmp/example.log" ||
    { cat "$tmp/example.log" "$tmp/relightd.log" >&2; fail "the example failed"; }
[ "$(head -c 4 "$tmp/box.png" | tail -c 3)" = PNG ] || fail "the example wrote no PNG"
