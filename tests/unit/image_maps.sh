#!/bin/bash
# SPDX-License-Identifier: MIT
# prt image by image-space engines with images over the model's uv: a uniform tint of 1/4 gives a quarter
# of the light, level normals change nothing, a bump does, and what cannot be is refused.
#   image_maps.sh PATH/TO/prt
set -u
export LC_ALL=C
prt=${1:?the prt program}
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir" || exit 1
failed=0

fail() {
    echo "FAIL: $*"
    sed 's/^/    /' err 2>/dev/null | head
    failed=$((failed + 1))
}
# A ball whose uv unfold it once, with a seam.
awk -v rings=24 -v n=48 'BEGIN {
    pi = atan2(0, -1)
    for (i = 0; i <= rings; i++) for (j = 0; j <= n; j++) {
        a = pi * i / rings; b = 2 * pi * j / n; s = (i == 0 || i == rings) ? 0 : sin(a)
        printf "v %.7f %.7f %.7f\nvt %.6f %.6f\n", s * sin(b), cos(a), s * cos(b), j / n, 1 - i / rings
    }
    for (i = 0; i < rings; i++) for (j = 0; j < n; j++) {
        a = i * (n + 1) + j + 1; b = a + n + 1
        if (i > 0) printf "f %d/%d %d/%d %d/%d\n", a, a, b, b, a + 1, a + 1
        if (i < rings - 1) printf "f %d/%d %d/%d %d/%d\n", a+1, a+1, b, b, b+1, b+1
    }
}' >ball.obj
grep -v '^vt' ball.obj | sed 's#/[0-9]*##g' >bare.obj
# One pixel of Radiance's format holds R,G,B * 2^(E-136).
hdr() { printf '#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X %d\n' "$2" >"$1"; shift 2; printf "$@"; }
hdr quarter.hdr 1 '\100\100\100\200' >>quarter.hdr        # 0.25
hdr level.hdr 1 '\200\200\377\200' >>level.hdr            # 0.5 0.5 0.996
hdr waves.hdr 8 '\100\100\100\200\200\200\200\200\300\300\300\200\377\377\377\200\377\377\377\200\300\300\300\200\200\200\200\200\100\100\100\200' >>waves.hdr

# Light from one side: 8x4 texels, one of them bright.
{
    printf '#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n'
    for ((i = 0; i < 32; i++)); do
        if [ $i = 11 ]; then printf '\200\200\200\205'; else printf '\20\20\20\200'; fi
    done
} >side.hdr

draw() { # OUT OPTION…
    local out=$1
    shift
    timeout 120 "$prt" image ball.obj --material marble --size-mm 40 --env side.hdr --engine "$engine" --scattering dipole \
        --samples "$samples" --size 96x96 --term multiple --background none --quiet "$@" -o "$out" 2>err ||
        fail "$out: $*"
}
# near A B RMSE TOLERANCE
near() {
    local got
    got=$("$prt" compare "$1" "$2" --json 2>err | sed 's/.*"rmse": *\([0-9.e+-]*\).*/\1/')
    echo "$1 against $2: relative RMSE $got, expected $3 within $4"
    awk -v a="$got" -v b="$3" -v t="$4" 'BEGIN { exit !(a - b < t && b - a < t) }' || fail "$1 $2"
}
refused() { # STATUS PATTERN OPTION…
    local want=$1 pattern=$2 got
    shift 2
    timeout 60 "$prt" image "$@" --material marble --size-mm 40 --env constant -o no.exr 2>err
    got=$?
    [ "$got" = "$want" ] || fail "status $got, not $want: $*"
    grep -Eq -- "$pattern" err || fail "no '$pattern': $*"
    [ ! -e no.exr ] || fail "no.exr was written: $*"
}
for pair in tangent:64 splat:80 texture:900 hybrid:900; do
    engine=${pair%:*} samples=${pair#*:}
    draw plain.exr
    draw tinted.exr --albedo-map quarter.hdr
    draw level.exr --normal-map level.hdr
    draw waves.exr --bump-map waves.hdr --bump-mm 4
    near tinted.exr plain.exr 0.75 0.03
    near level.exr plain.exr 0 0.01
    near waves.exr plain.exr 0.3 0.1
done
refused 2 'maps are for --engine splat, tangent' ball.obj --engine reference --albedo-map quarter.hdr
refused 2 'bump-mm is for' ball.obj --engine tangent --bump-mm 2
refused 2 'no texture coordinates' bare.obj --engine tangent --albedo-map quarter.hdr
refused 1 'none.hdr' ball.obj --engine tangent --normal-map none.hdr
exit $((failed > 0))
