#!/bin/bash
# SPDX-License-Identifier: MIT
# The Debian packages that `cpack -G DEB` makes: together they have what `cmake --install` lays down, each file
# once; names, dependencies and maintainer scripts are in order.
#   packages.sh BUILD_FOLDER
set -u
command -v dpkg-shlibdeps >/dev/null && command -v file >/dev/null || { echo "skipped: no dpkg-dev, or no file"; exit 77; }
build=$1
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
fail() { echo "FAIL: $*"; exit 1; }
(cd "$tmp" && cpack --config "$build/CPackConfig.cmake" -G DEB) >"$tmp/log" 2>&1 || { tail -20 "$tmp/log"; fail cpack; }
DESTDIR=$tmp/root cmake --install "$build" --prefix /usr >"$tmp/log" 2>&1 || { tail -5 "$tmp/log"; fail "cmake --install"; }
(cd "$tmp/root" && find . -type f -o -type l) | sort >"$tmp/installed"
: >"$tmp/packed"
for name in relightd relight librelight-dev relight-page; do
    deb=$(ls "$tmp/${name}"_*.deb 2>/dev/null) || { [ $name = relight-page ] && continue; fail "no package $name"; }
    [ "$(dpkg-deb -f "$deb" Package)" = $name ] || fail "the name of $name"
    dpkg-deb -c "$deb" | awk '$1 !~ /^d/ {print $6}' >>"$tmp/packed"
    dpkg-deb -e "$deb" "$tmp/control-$name"
done
sort "$tmp/packed" | uniq -d | grep . && fail "files in two packages"
sort "$tmp/packed" | diff "$tmp/installed" - >"$tmp/diff" || { head "$tmp/diff"; fail "packages and cmake --install differ"; }
dpkg-deb -f "$tmp"/relightd_*.deb Depends | grep -q libembree || fail "relightd's dependencies"
dpkg-deb -f "$tmp"/relight_*.deb Depends | grep -q embree && fail "the client depends on Embree"
# What names folders names those of the packages.
dpkg-deb -x "$tmp"/relightd_*.deb "$tmp/relightd"
dpkg-deb -x "$tmp"/librelight-dev_*.deb "$tmp/dev"
grep -qx 'ExecStart=/usr/bin/relightd --config /etc/relight/relightd.conf' "$tmp/relightd/usr/lib/systemd/system/relightd.service" ||
    fail "the unit's ExecStart"
[ -s "$tmp/relightd$(cat "$tmp/control-relightd/conffiles")" ] || fail "a conffile that is not in the package"
pc=$(find "$tmp/dev" -name relight.pc)
grep -qx prefix=/usr "$pc" || fail "relight.pc names another prefix"
# The library is shared: a program over it is linked without the development packages of what it uses.
PKG_CONFIG_LIBDIR=$(dirname "$pc") pkg-config --cflags --libs relight >/dev/null || fail "relight.pc wants other packages"
for script in postinst prerm postrm; do
    [ -x "$tmp/control-relightd/$script" ] && sh -n "$tmp/control-relightd/$script" || fail "$script"
done
echo "four packages, $(wc -l <"$tmp/installed") files, each in one"
