#!/bin/bash
# SPDX-License-Identifier: MIT
# The command contract of prt: help, exit statuses, refusals with their range, and every subcommand
# on tiny models made here.   cli.sh PATH/TO/prt
set -u
export LC_ALL=C
prt=${1:?the prt program}
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir" || exit 1
failed=0
count=0

fail() {
    echo "FAIL: $*"
    sed 's/^/    /' err out 2>/dev/null | head -20
    failed=$((failed + 1))
}
# expect STATUS PATTERN COMMAND…: exit status, and an extended regular expression that some line of
# standard error matches ('' : anything).
expect() {
    local want=$1 pattern=$2 got
    shift 2
    count=$((count + 1))
    timeout 120 "$@" >out 2>err </dev/null
    got=$?
    [ "$got" = "$want" ] || { fail "status $got, not $want: $*"; return 1; }
    [ -z "$pattern" ] || grep -Eq -- "$pattern" err || { fail "no '$pattern' in: $*"; return 1; }
    # Wrong usage and failures say why in one line that starts with error:.
    if [ "$want" != 0 ] && [ "$(grep -c '^error: ' err)" -lt 1 ]; then fail "no error line: $*"; fi
}
check() {
    count=$((count + 1))
    "$@" || fail "$*"
}

# A ball of radius 1: rings of a UV sphere, poles shared, outward triangles.
awk -v rings=8 -v n=12 'BEGIN {
    pi = atan2(0, -1); print "v 0 1 0"
    for (i = 1; i < rings; i++) for (j = 0; j < n; j++)
        printf "v %.7f %.7f %.7f\n", sin(pi*i/rings)*cos(2*pi*j/n), cos(pi*i/rings), -sin(pi*i/rings)*sin(2*pi*j/n)
    print "v 0 -1 0"
    last = (rings - 1) * n + 2
    for (j = 0; j < n; j++) {
        k = (j + 1) % n
        print "f", 1, 2 + j, 2 + k
        for (i = 0; i < rings - 2; i++) {
            a = 2 + i*n + j; b = 2 + i*n + k; print "f", a, a + n, b; print "f", b, a + n, b + n
        }
        print "f", last, 2 + (rings-2)*n + k, 2 + (rings-2)*n + j
    } }' >ball.obj
n=$(grep -c '^v ' ball.obj)
cat >tetra.gltf <<'J'
{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
"buffers":[{"byteLength":72,"uri":"data:application/octet-stream;base64,AACAPwAAgD8AAIA/AACAvwAAgL8AAIA/AACAvwAAgD8AAIC/AACAPwAAgL8AAIC/AAACAAEAAAABAAMAAAADAAIAAQACAAMA"}],
"bufferViews":[{"buffer":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":24}],
"accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[-1,-1,-1],"max":[1,1,1]},
{"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}]}
J
scaled="--material marble --size-mm 20"
# shellcheck disable=SC2086
{
# Help and words.
expect 0 '' "$prt" --help
check grep -q 'Exit status: 0 done, 1 failed, 2 wrong usage' out
for c in bake colors image info compare env; do
    check grep -q "prt $c" out
done
for c in bake colors image info compare env; do
    expect 0 '' "$prt" $c --help
    check grep -q "^Usage: prt $c " out
    check grep -q '^Examples:' out
    expect 0 '' "$prt" --help
done
expect 2 'subcommand' "$prt"
expect 2 'frobnicate is not a subcommand' "$prt" frobnicate
expect 2 'not an option' "$prt" info ball.obj --frobnicate
expect 2 'one operand too many' "$prt" info ball.obj ball.obj
expect 2 'needs' "$prt" bake ball.obj --size-mm
for c in bake colors image info compare env; do
    expect 0 '' "$prt" $c --version
    check grep -q '^prt [0-9]' out
done
expect 0 '' "$prt" --version
# One error line, whatever is wrong with a word; abbreviations are refused, also unambiguous ones.
expect_line() {
    local line=$1
    shift
    expect 2 '' "$@"
    check test "$(cat err)" = "error: $line; see prt ${2:+$2 }--help"
}
expect_line '--js is not an option here' "$prt" info ball.obj --js
expect_line '--mat is not an option here' "$prt" bake --mat marble ball.obj
expect_line '--mat=marble is not an option here' "$prt" bake --mat=marble ball.obj
expect_line '--vers is not an option here' "$prt" bake --vers
expect_line '--json takes no value' "$prt" info --json=3 ball.obj
expect_line '--output needs FILE' "$prt" bake ball.obj -o
expect_line '-z is not an option here' "$prt" bake -zq ball.obj
expect_line '-z is not an option here' "$prt" bake -qz ball.obj
expect_line '-z is not an option here' "$prt" bake -q -zq ball.obj
expect 2 '^error: --frob is not an option of prt; see prt --help$' "$prt" --frob
expect 0 '' "$prt" info -q -- ball.obj
for word in transport material size-mm mm-per-unit storage rank cube coeffs phase-terms samples env \
            threads shard draft profile progress-fd seed max-error opaque cpu json; do
    "$prt" bake --help | grep -q -- "--$word" || fail "bake --help lacks --$word"
done
for word in env engine rotate material term eye samples seed threads cube; do
    "$prt" colors --help | grep -q -- "--$word" || fail "colors --help lacks --$word"
done
for word in env engine camera size material rotate eye budget-ms opaque; do
    "$prt" image --help | grep -q -- "--$word" || fail "image --help lacks --$word"
done

# Nonsense is refused with the allowed range.
for bad in 0 -5 nan inf 1e9 5mm 0x10 ''; do
    expect 2 '(--size-mm .*\(0, 1000000\])|expected' "$prt" bake ball.obj --material marble --size-mm "$bad" -o x.prt
done
expect 2 '\[1, 1024\]' "$prt" bake ball.obj $scaled --threads 0 -o x.prt
expect 2 '16, 32, 64 or 128' "$prt" bake ball.obj $scaled --cube 48 -o x.prt
expect 2 '1, 4 or 9' "$prt" bake ball.obj $scaled --phase-terms 3 -o x.prt
expect 2 'whole number' "$prt" bake ball.obj $scaled --samples 1e5 -o x.prt
expect 2 '\[0, N-1\]' "$prt" bake ball.obj $scaled --shard 3/3 -o x.prt
expect 2 'one of factored, sparse' "$prt" bake ball.obj $scaled --storage dense -o x.prt
expect 2 'one of reduced, polynomial, hat' "$prt" bake ball.obj $scaled --basis dense -o x.prt
expect 2 '--basis is for --transport polynomial' "$prt" bake ball.obj $scaled --basis hat -o x.prt
expect 2 '--any-eta is for --transport joint' "$prt" bake ball.obj $scaled --any-eta -o x.prt
expect 2 '--any-eta and --exit-planes exclude each other' "$prt" bake ball.obj --size-mm 20 --any-eta --exit-planes -o x.prt
expect 2 '--any-eta is for --scattering dipole' "$prt" bake ball.obj --size-mm 20 --any-eta --scattering walk -o x.prt
expect 2 '--draft is for --transport wavelet and joint' "$prt" bake ball.obj $scaled --draft --transport polynomial --env constant -o x.prt
expect 2 '--coeffs is for --storage sparse' "$prt" bake ball.obj $scaled --coeffs 64 -o x.prt
expect 2 'choose one' "$prt" bake ball.obj $scaled --mm-per-unit 3 -o x.prt
expect 2 'needs --env' "$prt" bake ball.obj $scaled --transport polynomial -o x.prt
expect 2 'no such open file descriptor' "$prt" bake ball.obj $scaled --progress-fd 77 -o x.prt
expect 2 'marble' "$prt" bake ball.obj --material granite --size-mm 20 -o x.prt
expect 2 'mean free path .* at most 256 ' "$prt" bake ball.obj --material marble --size-mm 1e6 --samples 2000 -o x.prt
expect 2 'mean free path .* at most 256 ' "$prt" colors ball.obj --material marble --size-mm 1e6 --samples 2000 --env constant -o x.csv
expect 2 '-o OUT.prt is missing' "$prt" bake ball.obj $scaled
expect 2 'needs --material' "$prt" bake ball.obj --size-mm 20 --transport wavelet -o x.prt
expect 2 'no material or node named "flor"' "$prt" bake tetra.gltf $scaled --opaque flor -o x.prt
expect 2 'no material or node named "flor"' "$prt" info tetra.gltf --opaque flor
expect 2 'units' "$prt" bake ball.obj --material marble -o x.prt
expect 1 'No such file' "$prt" bake nowhere.obj $scaled -o x.prt
expect 1 'No such file' "$prt" bake ball.obj $scaled -o no/such/folder/x.prt
echo words >words.txt
expect 1 'words.txt: not an image of a known format' "$prt" colors ball.obj $scaled --env words.txt -o x.csv
expect 2 '.csv, .npy, .ply or .glb' "$prt" colors ball.obj $scaled --env constant -o x.txt
expect 2 '--env is missing' "$prt" colors ball.obj $scaled -o x.csv
expect 2 'bake .* first' "$prt" colors ball.obj $scaled --env constant --engine wavelet -o x.csv
expect 2 'bake .* first' "$prt" image ball.obj $scaled --env constant --engine vertex -o x.png
expect 2 'three numbers' "$prt" colors ball.obj $scaled --env constant --eye 1,2 -o x.csv
expect 2 '\[4, 2048\], or full' "$prt" colors ball.obj $scaled --env constant --cube huge -o x.csv
for camera in 1,2,3 1,2 0,0,1:0,0,0:0,1,0:170 0,0,1:0,0,1; do
    expect 2 "^error: --camera.*; see prt image --help$" \
        "$prt" image ball.obj $scaled --env constant --camera $camera -o x.png
    check test "$(wc -l <err)" = 1
done
expect 2 'WxH' "$prt" image ball.obj $scaled --env constant --size 0x5 -o x.png
expect 2 'WxH' "$prt" image ball.obj $scaled --env constant --size 5000x5 -o x.png
expect 1 'No such file' "$prt" colors nowhere.prt --env constant -o x.csv
for material in '{"sigma_s_prime":[-1,1,1],"sigma_a":[0,0,0],"eta":1.3}' \
                '{"sigma_s_prime":[1,1,1],"sigma_a":[0,0,0],"eta":0.5}' \
                '{"sigma_s_prime":[1,1,1],"sigma_a":[0,0,0],"g":1,"eta":1.3}'; do
    expect 2 '' "$prt" colors ball.obj --material "$material" --size-mm 20 --env constant -o x.csv
    echo "$material" >bad.json
    expect 1 '' "$prt" colors ball.obj --material bad.json --size-mm 20 --env constant -o x.csv
done
check [ -z "$(ls x.* 2>/dev/null)" ]

# info
expect 0 '' "$prt" info ball.obj --json
check grep -q "\"vertices\":$n," out
check grep -q '"units":"unknown"' out
expect 0 '' "$prt" info tetra.gltf
check grep -q 'units: m$' out
expect 0 '' "$prt" info constant:1,2,3 --json
check grep -Eq '"mean_radiance":\[(1|1\.00000[0-9]*|0\.99999[0-9]*),' out

# Reference on a model: all endings; a constant light on a convex body has E = 2.853264 at eta 1.5
# (METHODS, notation).
quick="--samples 500 --rays 256 --single-points 64 --cube 16"
expect 0 '' "$prt" colors ball.obj $scaled --env constant --term irradiance $quick -o e.csv
check [ "$(head -1 e.csv)" = vertex,r,g,b ]
check [ "$(wc -l <e.csv)" = $((n + 1)) ]
check awk -F, 'NR > 1 { s += $2; if ($2 < 2.7 || $2 > 3) exit 1 }
    END { m = s / (NR - 1); if (m < 2.839 || m > 2.868) exit 1 }' e.csv
for ending in npy ply glb; do
    expect 0 '' "$prt" colors ball.obj $scaled --env constant --term irradiance $quick -o e.$ending
done
expect 0 '' "$prt" compare e.csv e.npy --max-rmse 1e-7
expect 0 'metres' "$prt" colors tetra.gltf --material skin1 --env constant --term irradiance $quick -o t.csv
expect 0 '' "$prt" colors ball.obj $scaled --env constant --term multiple $quick -o truth.npy --json
check grep -q '"engine":"reference"' out

# bake, then everything a .prt answers.
bake="--samples 2000 --cube 16 --single-points 4 --threads 2"
expect 0 '' "$prt" bake ball.obj $scaled $bake -o ball.prt
check grep -Eq 'ball.prt: .* [0-9]+ bytes of transport a vertex' out
expect 0 '' "$prt" bake ball.obj $scaled $bake --threads 1 --progress-fd 1 -o again.prt
check cmp ball.prt again.prt
expect 0 '' "$prt" bake ball.obj $scaled $bake --shard 1/2 -o parts.prt
check grep -q 'shard 1/2 done .* 1 of 2 to come' out
check [ ! -e parts.prt ]
expect 0 '' "$prt" bake ball.obj $scaled $bake --shard 1/2 --json -o parts.prt
check grep -q '"shard":1,"shards":2,"parts_missing":1' out
expect 0 '' "$prt" bake ball.obj $scaled $bake --shard 0/2 -o parts.prt
check cmp ball.prt parts.prt
check [ -z "$(ls parts.prt.* 2>/dev/null)" ]
expect 0 '' "$prt" bake ball.obj $scaled $bake --threads 1 --progress-fd 1 -o again.prt
check grep -Eq '^[^ ]+ [01]\.[0-9]+ -?[0-9.]+$' out
expect 0 '' "$prt" info ball.prt --json
check grep -q '"engine":"wavelet"' out
check grep -q '"storage":"factored"' out
check grep -q '"rmse\|"errors":{' out
expect 0 '' "$prt" colors ball.prt --env constant --term multiple -o m.csv
check [ "$(wc -l <m.csv)" = $((n + 1)) ]
expect 0 '' "$prt" compare m.csv truth.npy --max-rmse 0.1
expect 1 'above --max-rmse' "$prt" compare m.csv e.csv --max-rmse 0.01
expect 0 '' "$prt" compare ball.prt reference --env constant --term multiple --samples 2000 --vertices 20 --json \
    --env constant:0.2,0.2,0.2 --env constant:0.5,0.5,0.5
grep -q '"rmse":{"constant":.*,"constant:0.2,0.2,0.2":.*,"constant:0.5,0.5,0.5":' out ||
    fail "a light has no key of its own: $(cat out)"
expect 0 '' "$prt" compare ball.prt reference --env constant --term multiple --samples 2000 --vertices 20 --json
check grep -q '"count":20,' out
# With --eye vertices that it does not see are left out: of an object behind another, and of a
# triangle that faces away. A mean rank counts every vertex.
printf '%s\n' 'o front' 'v -2 -2 1' 'v 2 -2 1' 'v 2 2 1' 'v -2 2 1' 'v 3 -1 1' 'v 5 -1 1' 'v 5 1 1' 'f 1 2 3' 'f 1 3 4' \
    'f 7 6 5' 'o hidden' 'v -1 -1 0' 'v 1 -1 0' 'v 0 1 0' 'f 8 9 10' >hidden.obj
expect 0 '' "$prt" bake hidden.obj $scaled $bake --no-single -o hidden.prt
expect 0 '' "$prt" compare hidden.prt reference --env constant --term multiple --samples 500 --eye 0,0,5 --json
check grep -q '"count":4,' out
expect 0 '' "$prt" info hidden.prt --json
check grep -Eq '"mean_rank":([0-9.]+),.*"cluster_rank":\{"min":[0-9]+,"mean":\1,' out
expect 2 'leave --material out' "$prt" colors ball.prt --material skin1 --env constant -o x.csv
expect 2 'baked for --engine wavelet' "$prt" colors ball.prt --engine joint --env constant -o x.csv
expect 2 'carries its own scale' "$prt" colors ball.prt --size-mm 20 --env constant -o x.csv
expect 2 'the model at rest alone' "$prt" colors ball.prt --time 1 --env constant -o x.csv
expect 2 'flip-v' "$prt" colors ball.prt --flip-v --env constant -o x.csv
expect 2 'reference only' "$prt" colors ball.prt --cube 32 --env constant -o x.csv
expect 0 'traced again' "$prt" colors ball.prt --env constant --term irradiance $quick -o e2.csv
expect 0 '' "$prt" compare e2.csv e.csv --max-rmse 1e-6
expect 0 '' "$prt" colors ball.prt --env constant --engine reference --term multiple $quick -o r.npy
expect 0 '' "$prt" compare r.npy truth.npy --max-rmse 1e-6
expect 0 '' "$prt" colors ball.prt --env constant --eye 0,0,5 -o eye.csv
check [ -z "$(ls x.* 2>/dev/null)" ]
expect 0 '' "$prt" bake ball.obj $scaled $bake --storage sparse --coeffs 64 -o sparse.prt
expect 0 '' "$prt" colors sparse.prt --env constant --term multiple -o s.csv
expect 0 '' "$prt" compare s.csv truth.npy --max-rmse 0.1

# Free media: joint where nothing fixes one, polynomial under its own light; a layered slab, a curve
# from a CSV, normalised diffusion; tables of media and lights; what is out of range.
echo '{"name":"slab","profile":"multipole","layers":[{"thickness":2,"sigma_s_prime":1,"sigma_a":0.02},{"sigma_s_prime":2,"sigma_a":0.3}]}' >slab.json
echo '{"profile":"curve","file":"curve.csv","name":"felt"}' >felt.json
awk 'BEGIN { print "r,R_d"; for (i = 0; i <= 60; i++) { r = i * i / 200; print r "," exp(-0.9 * r) / 12 } }' >curve.csv
wax='{"name":"wax","profile":"burley","albedo":[0.9,0.8,0.7],"mean_free_path":3}'
expect 0 'baked for eta 1.3' "$prt" bake ball.obj --size-mm 20 $bake --no-single -o joint.prt
expect 0 '' "$prt" info joint.prt --json
check grep -Eq '"media":\{"skin1":[0-9.]+,"ketchup":[0-9.]+,"skimmilk":[0-9.]+\},"worst"' out
check grep -q '"engine":"joint"' out
check grep -q '"cluster_rank":{"min":' out
check grep -q '"preset_worst_error":' out
check grep -q '"spectralon":' out
expect 0 '' "$prt" info joint.prt
check grep -q 'histogram_by_8: \[' out
expect 0 'warning: joint.prt was baked without single scattering' "$prt" colors joint.prt --env constant --term single -o s.csv
for material in skin1 slab.json felt.json "$wax"; do
    expect 0 '' "$prt" colors joint.prt --engine joint --material "$material" --env constant --term multiple -o j.csv --json
    check grep -q '"material_error":' out
    expect 0 '' "$prt" colors ball.obj --size-mm 20 --material "$material" --env constant --term multiple $quick -o truth2.csv
    expect 0 '' "$prt" compare j.csv truth2.csv --max-rmse 0.1
done
expect 0 '' "$prt" compare joint.prt reference --env constant --env constant:1,2,3 --materials skin1,slab.json,ketchup \
    --term multiple --samples 4000 --vertices 20 --max-rmse 0.1
check grep -Eq '^slab +[0-9.]+ +[0-9.]+ +[0-9.]+$' out
check grep -q 'worst .* target 10 %: met' out
expect 0 '' "$prt" compare joint.prt reference --env constant --materials skin1 --term multiple --samples 4000 --vertices 10
check grep -Eq '^worst [0-9.]+ %$' out
expect 1 'above --max-rmse' "$prt" compare joint.prt reference --env constant --materials range --term multiple \
    --samples 4000 --vertices 10 --max-rmse 1e-9 --json
check grep -q '"media":\[{"material":"' out
# Where the samples resolve no medium's mean free path, nothing is judged, and --max-rmse is not met.
expect 1 'has none to judge' "$prt" compare joint.prt reference --env constant --term multiple --samples 4000 --vertices 10 \
    --materials '{"sigma_s_prime":[20,20,20],"sigma_a":[0.1,0.1,0.1]}' --max-rmse 1 --json
check grep -q '"worst":null,"target":1,"within":false' out
# --cube is the resolution at which the reference sees a light, here a small sun.
awk 'BEGIN { printf "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n"
    for (i = 0; i < 512; i++) printf i == 140 ? "\177\177\177\207" : "\3\3\3\170" }' >sun.hdr
sun="--env sun.hdr --materials skin1 --term multiple --samples 4000 --vertices 20 --max-rmse 0.018"
expect 0 '' "$prt" compare joint.prt reference $sun
expect 1 'above --max-rmse' "$prt" compare joint.prt reference $sun --cube 4
expect 2 'sigma_s_prime\[0\] is 900, this bake covers 0.02 to 25 mm\^-1' "$prt" colors joint.prt --env constant -o x.csv \
    --material '{"sigma_s_prime":[900,1,1],"sigma_a":[0,0,0]}'
expect 2 'eta is 1.5, this bake is for 1.3' "$prt" colors joint.prt --env constant --material marble -o x.csv
expect 2 'eta is 1.5' "$prt" image joint.prt --env constant --material marble -o x.png
expect 2 'eta is 1.5' "$prt" compare joint.prt reference --env constant --materials marble --term multiple
# One bake for media of every eta from 1.2 to 1.6, and a medium outside.
expect 0 '' "$prt" bake ball.obj --size-mm 20 $bake --no-single --any-eta -o any.prt
check [ -z "$(grep 'baked for eta' err)" ]
expect 0 '' "$prt" info any.prt --json
check grep -q '"eta_range":\[1.2,1.6\]' out
expect 0 '' "$prt" compare any.prt reference --env constant --materials media --term multiple --max-rmse 0.01 \
    --samples 20000 --vertices 10
check grep -q '^marble ' out
check grep -q '^skin1 ' out
expect 2 'eta is 1.65, this bake covers 1.2 to 1.6' "$prt" colors any.prt --env constant -o x.csv \
    --material '{"sigma_s_prime":[1,1,1],"sigma_a":[0.1,0.1,0.1],"eta":1.65}'
expect 2 'eta is 1.7, --any-eta covers 1.2 to 1.6' "$prt" bake ball.obj --size-mm 20 $bake --transport joint --any-eta \
    --material '{"name":"glass","sigma_s_prime":[1,1,1],"sigma_a":[0.1,0.1,0.1],"eta":1.7}' -o x.prt
expect 2 'covers 0 to 2 mm' "$prt" image joint.prt --env constant -o x.png \
    --material '{"sigma_s_prime":[1,1,1],"sigma_a":[300,300,300]}'
expect 2 'mean_free_path.*0.001 to 10000 mm' "$prt" colors joint.prt --env constant -o x.csv \
    --material '{"profile":"burley","albedo":1,"mean_free_path":0}'
expect 2 'leave --materials out' "$prt" compare ball.prt reference --env constant --materials all
expect 2 'materials is for B = reference' "$prt" compare m.csv truth.npy --materials all
for option in '--env constant' '--term single' '--eye 1,2,3' '--exit papers' '--rotate 30' '--cube 16' \
    '--scattering walk' '--samples 9' '--rays 9' '--single-points 9' '--vertices 9' '--material skin1'; do
    # shellcheck disable=SC2086
    expect 2 "${option% *} is for B = reference" "$prt" compare m.csv truth.npy $option
done
expect 0 '' "$prt" bake ball.obj --material "$wax" --size-mm 20 $bake --transport polynomial --env constant:1,1,2 -o poly.prt
for material in skin1 "$wax"; do
    expect 0 '' "$prt" colors poly.prt --engine polynomial --material "$material" --term multiple -o p.csv
    expect 0 '' "$prt" compare poly.prt reference --materials "$material" --env constant:1,1,2 --term multiple \
        --samples 4000 --vertices 20 --max-rmse 0.1
done
expect 0 '' "$prt" bake ball.obj --size-mm 20 $bake --transport polynomial --basis polynomial --env constant:1,1,2 -o x07.prt
expect 0 '' "$prt" info x07.prt --json
check grep -q '"kind":"polynomial","of":"R_d","functions":32' out
check grep -q '"kind":"polynomial","of":"e^(-sigma_t r)","functions":16' out
expect 0 '' "$prt" compare x07.prt reference --materials skin1 --env constant:1,1,2 --term multiple \
    --samples 4000 --vertices 20 --max-rmse 0.1
for materials in '' '--materials skin1'; do
    # shellcheck disable=SC2086
    expect 2 'was baked under constant:1,1,2' "$prt" compare poly.prt reference $materials --env constant:3 --term multiple
done
expect 0 '' "$prt" bake ball.obj --size-mm 20 $bake --transport polynomial --env constant:1,1,2 --rotate 40 -o turned.prt
expect 0 '' "$prt" info turned.prt --json
check grep -q '"rotate_deg":40' out
expect 2 'turned by 40 degrees: give --rotate 40' "$prt" compare turned.prt reference --materials skin1 \
    --env constant:1,1,2 --term multiple
expect 0 '' "$prt" compare turned.prt reference --materials skin1 --env constant:1,1,2 --rotate 40 --term multiple \
    --samples 4000 --vertices 20 --max-rmse 0.1
expect 0 '' "$prt" bake ball.obj --material slab.json --size-mm 20 $bake -o slab.prt
expect 0 '' "$prt" info slab.prt --json
check grep -q '"profile":"multipole"' out
expect 0 '' "$prt" compare slab.prt reference --env constant --term total --samples 4000 --vertices 20 --max-rmse 0.1
check [ -z "$(ls x.* 2>/dev/null)" ]

# image: three endings agree with each other as far as 8 bits go.
view="--size 64x48 --background none"
expect 0 '' "$prt" image ball.prt --env constant $view -o i.exr --json
check grep -q '"width":64' out
for ending in png jpg; do
    expect 0 '' "$prt" image ball.prt --env constant $view -o i.$ending
    check [ -s i.$ending ]
done
expect 0 '' "$prt" image ball.prt --env constant $view --camera 0,0,5:0,0,0:0,1,0:30 -o c.exr
expect 0 '' "$prt" image ball.prt --env constant $view --eye 0,0,5 -o c2.exr
expect 0 '' "$prt" image ball.obj $scaled $quick --env constant $view -o ref.exr
expect 0 '' "$prt" compare i.exr ref.exr --max-rmse 0.1
for engine in splat tangent texture hybrid; do
    expect 0 '' "$prt" image ball.obj $scaled --engine $engine --env constant --term multiple $view -o $engine.exr --json
    check grep -q "\"engine\":\"$engine\"" out
done
expect 0 '' "$prt" image ball.prt --engine splat --env constant --term multiple $view -o prt.exr
expect 2 'multiple or total' "$prt" image ball.prt --engine splat --env constant --term single $view -o x.exr
expect 1 'has 64x48 pixels' "$prt" compare i.exr "$(expect 0 '' "$prt" image ball.prt --env constant --size 32x24 -o small.exr; echo small.exr)"
expect 1 'picture' "$prt" compare i.exr m.csv

# A folder that cannot be written is told before the model is read; root writes everywhere.
mkdir closed && chmod 555 closed && chmod 755 .
as=
[ "$(id -u)" != 0 ] || as="setpriv --reuid=65534 --clear-groups"
# shellcheck disable=SC2086 # words
if $as "$prt" --version >out 2>err; then # not where another user cannot reach the program
    expect 1 'closed/x.prt: Permission denied' $as "$prt" bake missing.obj $scaled -o closed/x.prt
    expect 1 'missing.obj' $as "$prt" bake missing.obj $scaled -o /tmp/x.prt
fi

# env: both ways, power kept.
expect 0 'power' sh -c "'$prt' env constant:2,1,0.5 -o cube.exr --size 32 >&2"
expect 0 '' "$prt" env cube.exr -o flat.exr --size 64x32 --json
check grep -q '"width":64' out
expect 0 '' "$prt" env flat.exr -o back.exr --size 32
expect 0 '' "$prt" compare cube.exr back.exr --max-rmse 0.002
expect 0 '' "$prt" env cube.exr --layout vcross -o cross.hdr
expect 0 '' "$prt" env cross.hdr -o back.exr --layout envmap --size 32
expect 0 '' "$prt" compare cube.exr back.exr --max-rmse 0.004
for layout in hcross vcross vstrip hstrip; do
    expect 0 '' "$prt" env cube.exr --layout $layout --size 32 -o $layout.exr
    expect 0 '' "$prt" info $layout.exr --json
    check grep -q '"layout":"cube"' out
done
expect 2 'attribute of OpenEXR' "$prt" env cube.exr --layout envmap -o x.png
# Without --size a lat-long image keeps its size, and then its pixels.
expect 0 '' python3 -c '
rows = b"".join(bytes((37 * x * x + 91 * y * y) % 200 + 50 if c < 3 else 128 for c in range(4))
                for y in range(32) for x in range(64))
open("rough.hdr", "wb").write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n" + rows)'
expect 0 '' "$prt" env rough.hdr --layout latlong -o same.exr --float
expect 0 '' "$prt" compare same.exr rough.hdr --max-rmse 1e-6

# Damaged and foreign files fail with a line and leave nothing behind.
head -c 500 ball.prt >cut.prt
expect 1 'cut.prt' "$prt" info cut.prt
expect 1 'cut.prt' "$prt" colors cut.prt --env constant -o x.csv
echo hello >foreign.prt
expect 1 'foreign.prt' "$prt" info foreign.prt
echo hello >foreign.glb
expect 1 'foreign.glb' "$prt" bake foreign.glb $scaled -o x.prt
expect 1 'foreign.hdr' sh -c "echo hello >foreign.hdr; exec '$prt' colors ball.prt --env foreign.hdr -o x.csv"
printf 'vertex,r,g,b\n0,1,2\n' >short.csv
expect 1 'short.csv: line 2' "$prt" compare short.csv short.csv
check [ -z "$(ls x.* ./*.tmp* 2>/dev/null)" ]

# A signal cancels a bake: status 1, no file, no temporary file.
"$prt" bake ball.obj $scaled --samples 4000000 --max-error 0.0001 --cube 128 -o stopped.prt >out 2>err &
job=$!
# Until it has its handler: bit 14 of the caught signals is SIGTERM.
for _ in $(seq 600); do
    caught=$(sed -n 's/^SigCgt:[^0-9a-f]*//p' /proc/$job/status)
    [ $((0x${caught:-0} & 0x4000)) = 0 ] || break
    sleep 0.1
done
kill -TERM $job
wait $job
status=$?
count=$((count + 1))
[ $status = 1 ] || fail "a cancelled bake ended with $status"
grep -q 'cancelled' err || fail "a cancelled bake did not say so"
check [ -z "$(ls stopped* 2>/dev/null)" ]
}

echo "$count checks, $failed failed"
[ $failed = 0 ]
