#!/bin/bash
# SPDX-License-Identifier: MIT
# The Debian packages in a system of their own: they install with what they depend on, the programs in
# them bake, serve and draw as the user that relightd's package makes, and nothing of them is left
# after a purge. Wants root, debootstrap and a Debian mirror (MIRROR, or deb.debian.org).
#   packages_chroot.sh BUILD_FOLDER
set -u
build=$1
[ "$(id -u)" = 0 ] && command -v debootstrap >/dev/null || { echo "skipped: not root, or no debootstrap"; exit 77; }
command -v dpkg-shlibdeps >/dev/null && command -v file >/dev/null || { echo "skipped: no dpkg-dev, or no file"; exit 77; }
. /etc/os-release
[ "${ID-}" = debian ] || { echo "skipped: packages are made for the system that builds them, which is no Debian"; exit 77; }
tmp=$(mktemp -d /var/tmp/relight-chroot-XXXXXX)
root=$tmp/root
cleanup() {
    umount "$root/proc" 2>/dev/null
    rm -rf --one-file-system "$tmp"
}
trap cleanup EXIT
fail() { echo "FAIL: $*"; [ ! -s "$tmp/log" ] || tail -20 "$tmp/log"; exit 1; }
inside() { env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C DEBIAN_FRONTEND=noninteractive chroot "$root" "$@"; }

mkdir "$tmp/debs"
(cd "$tmp/debs" && cpack --config "$build/CPackConfig.cmake" -G DEB) >"$tmp/log" 2>&1 || fail cpack
rm -rf "$tmp/debs/_CPack_Packages"
debootstrap --variant=minbase "$VERSION_CODENAME" "$root" "${MIRROR:-http://deb.debian.org/debian}" >"$tmp/log" 2>&1 || {
    grep -qi 'failed to \(get\|retrieve\|fetch\)\|unable to' "$tmp/log" && { echo "skipped: no mirror"; exit 77; }
    fail debootstrap
}
mount -t proc none "$root/proc" 2>/dev/null
cp -r "$tmp/debs" "$root/debs"
# Services are not started in a chroot.
printf '#!/bin/sh\nexit 101\n' >"$root/usr/sbin/policy-rc.d"
chmod 755 "$root/usr/sbin/policy-rc.d"

# Pictures want libosmesa6, which the package recommends.
inside sh -c 'apt-get -q update && apt-get -qy --no-install-recommends install libosmesa6 /debs/*.deb' >"$tmp/log" 2>&1 ||
    fail "apt-get install"
inside sh -c 'cat /var/lib/dpkg/info/relight*.list /var/lib/dpkg/info/librelight*.list' | sort -u >"$tmp/files"
inside getent passwd relight | grep -q nologin || fail "the user relight"

# ---- they work
cat >"$root/tmp/work" <<'END'
set -e
cd "$(mktemp -d)"
printf 'v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n' >small.obj
printf 'f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n' >>small.obj
relightd --data "$PWD/data" --listen "unix:$PWD/s" &
daemon=$!
for _ in $(seq 600); do [ -S s ] && break; sleep .1; done
relight -s "unix:$PWD/s" load small.obj --size-mm 20 --material marble --wait --samples 1000
relight -s "unix:$PWD/s" image small --env constant --size 64x48 -o out.png
test "$(head -c 4 out.png | tail -c 3)" = PNG
kill $daemon
wait $daemon
END
chmod 644 "$root/tmp/work"
inside su -s /bin/sh relight -c 'sh /tmp/work' >"$tmp/log" 2>&1 || fail "the installed programs"
inside relight-control --help >"$tmp/log" 2>&1 || fail "relight-control"

# ---- they go
inside apt-get -qy purge relightd relight librelight-dev relight-page >"$tmp/log" 2>&1 || fail "apt-get purge"
grep 'warning: while removing' "$tmp/log" && fail "folders are left"
left=0
while read -r file; do
    [ ! -d "$root$file" ] && { [ -e "$root$file" ] || [ -L "$root$file" ]; } && echo "left: $file" && left=1
done <"$tmp/files"
[ $left = 0 ] || fail "files are left"
inside sh -c "dpkg-query -W -f '\${db:Status-Status} \${Package}\n' | grep relight" && fail "packages are left"
echo "installed, used and removed: $(wc -l <"$tmp/files") files"
