#!/bin/bash
# SPDX-License-Identifier: MIT
# relight and relight-preview against a live daemon: a ball is uploaded, baked and relit; the
# picture drawn by the client is the daemon's own; one without a bake is seen and moved.
#   preview.sh BIN
set -u
export LC_ALL=C
bin=${1:?the folder of the programs}
tests=$(cd "$(dirname "$0")" && pwd)
dir=$(mktemp -d)
cd "$dir" || exit 1
daemon=
finish() {
    [ -z "$daemon" ] || kill "$daemon" 2>/dev/null
    rm -rf "$dir"
}
trap finish EXIT
fail() {
    echo "FAIL: $*"
    tail -n 4 out err daemon.log 2>/dev/null | sed 's/^/    /'
    exit 1
}
# expect STATUS PROGRAM ARGUMENTS…
expect() {
    local want=$1 got program=$2
    shift 2
    timeout 400 "$bin/$program" "$@" >out 2>err </dev/null
    got=$?
    [ $got = "$want" ] || fail "status $got, not $want: $program $*"
}
same() { # A B MAX-RMSE
    "$bin/prt" compare "$1" "$2" --max-rmse "$3" >out 2>err || fail "$1 and $2 differ: $(cat out err)"
}

awk -v rings=24 -v n=36 'BEGIN {
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

# A sky: bright above, dim and reddish below, 64 x 32 flat RGBE.
{
    printf '#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n'
    for y in $(seq 32); do
        for x in $(seq 64); do
            if [ "$y" -lt 9 ] && [ "$x" -lt 20 ]; then printf '\300\260\240\202'
            elif [ "$y" -lt 17 ]; then printf '\200\220\240\200'
            else printf '\220\160\100\176'; fi
        done
    done
} >sky.hdr

export RELIGHT_SERVER=unix:$dir/d.sock
mkdir data
PATH=$bin:$PATH "$bin/relightd" --preview-walks=no --data data --listen "$RELIGHT_SERVER" >daemon.log 2>&1 &
daemon=$!
for _ in $(seq 600); do
    "$bin/relight" ping >/dev/null 2>&1 && break
    sleep 0.1
done

expect 0 relight load ball.obj --size-mm 20 --material skin1 --samples 4000 --cube 16 --wait --name ball
grep -q ready out || fail "load --wait did not end ready"
expect 0 relight load ball.obj --size-mm 20 --material skin1 --samples 4000 --cube 16 --json --name ball
grep -q '"state":"ready"' out || fail "the second load baked again"
expect 0 relight info ball --json
grep -q '"vertices":830' out || fail "info counts the vertices wrong"

expect 0 relight colors ball --env sky.hdr --term multiple -o m.csv
[ "$(head -1 m.csv)" = vertex,r,g,b ] && [ "$(wc -l <m.csv)" = 831 ] || fail "CSV has the wrong shape"
expect 0 relight colors ball --env sky.hdr --term multiple --format f16 -o m.npy
same m.npy m.csv 1e-3
expect 0 relight colors ball --env sky.hdr --term multiple --format rgb9e5 -o m.npy
same m.npy m.csv 4e-3
expect 0 relight colors ball --env constant:1,1,1 --env sky.hdr --gain 1 --gain 2 -o sum.npy
expect 0 relight colors ball --env sky.hdr --env constant:1,1,1 --gain 2 --gain 1 -o mus.npy
same mus.npy sum.npy 1e-5
expect 0 relight colors ball --env sky.hdr --rotate 90 -o c.ply
expect 0 relight colors ball --env sky.hdr --rotate 90 -o c.glb
expect 0 prt info c.glb
grep -q 'vertices: 830' out || fail "the .glb is not the ball"
expect 1 relight colors nothing --env sky.hdr -o x.csv
expect 2 relight colors ball --env sky.hdr --material marble -o x.csv
[ ! -e x.csv ] || fail "a refused request left a file"

for how in "" "--rotate 70 --camera 0,1,4:0,0,0 --background 0,0,0"; do
    # shellcheck disable=SC2086
    expect 0 relight image ball --env sky.hdr --size 160x120 $how -o daemon.exr
    # shellcheck disable=SC2086
    expect 0 relight-preview ball --env sky.hdr --size 160x120 $how --format f32 -o client.exr
    same client.exr daemon.exr 0.005
done
# of several cameras the last one holds
for program in "relight image" relight-preview; do
    while IFS='|' read -r before last; do
        # shellcheck disable=SC2086
        expect 0 $program ball --env sky.hdr --size 48x36 $before $last -o both.exr
        # shellcheck disable=SC2086
        expect 0 $program ball --env sky.hdr --size 48x36 $last -o last.exr
        cmp both.exr last.exr || fail "$program: not the last of $before $last"
    done <<'END'
--camera side|--orbit 30,20
--camera 0,1,4:0,0,0|--orbit 30,20
--orbit 70,-10,2|--camera 0,1,4:0,0,0
--orbit 70,-10,2|--orbit 30,20
--camera 3,1,0:0,0,0:0,0,1:60|--camera 0,1,4:0,0,0
END
done
# planes of exit: the daemon's pictures towards each eye are the client's, and differ from those of
# a bake without them
echo '{"sigma_s_prime":[0.5,0.5,0.5],"sigma_a":[0.02,0.05,0.1],"eta":1.3}' >thin.json
for more in "" --exit-planes; do
    expect 0 relight load ball.obj --size-mm 20 --material thin.json --samples 4000 --cube 16 --wait --name "thin$more" $more
    expect 0 relight image "thin$more" --env sky.hdr --size 160x120 --camera 4,1,0:0,0,0 -o "daemon$more.exr"
    expect 0 relight-preview "thin$more" --env sky.hdr --size 160x120 --camera 0,1,4:0,0,0 --frames 4 --format rgb9e5 \
        -o client.exr
    same client-001.exr "daemon$more.exr" 0.005
done
"$bin/prt" compare daemon.exr daemon--exit-planes.exr --max-rmse 0.01 >out 2>&1 && fail "planes of exit change nothing"
# an anisotropic medium: its colours depend on the camera
echo '{"name":"forward","sigma_s_prime":[1,1,1],"sigma_a":[0.05,0.05,0.05],"g":[0.7,0.7,0.7],
    "eta":1.3}' >forward.json
expect 0 relight load ball.obj --size-mm 20 --material forward.json --samples 4000 --cube 16 --wait --name forward
expect 0 relight image forward --env sky.hdr --size 160x120 --camera 4,1,0:0,0,0 -o daemon.exr
expect 0 relight-preview forward --env sky.hdr --size 160x120 --camera 0,1,4:0,0,0 --frames 4 --format f32 -o client.exr
same client-001.exr daemon.exr 0.005
expect 0 relight-preview ball --env sky.hdr --frames 3 --size 64x48 -o turn.jpg
[ -s turn-000.jpg ] && [ -s turn-002.jpg ] || fail "a turntable's frames are missing"
expect 0 relight-preview ball --env sky.hdr --env constant --frames 4 --turn light --sheet \
    --size 64x48 --gap 2 -o sheet.png --json
grep -q '"width":262,"height":98' out || fail "the sheet has the wrong size"
# materials in columns, each as it is drawn alone; the difference of two pictures; films
expect 0 relight load ball.obj --size-mm 20 --samples 4000 --cube 16 --wait --name open
expect 0 relight-preview open --env sky.hdr --env constant --try skin1 --try ketchup --size 64x48 -o try.exr
expect 0 relight-preview open --env sky.hdr --material ketchup --size 64x48 -o one.exr
same try-0-001.exr one.exr 1e-6
expect 0 relight-preview open --env sky.hdr --env constant --try skin1 --try ketchup --try cream --sheet \
    --size 64x48 --gap 2 -o sheet.png --json
grep -q '"width":196,"height":98' out || fail "the sheet of materials has the wrong size"
expect 0 relight-preview open --env sky.hdr --try skin1 --try ketchup --difference --size 64x48 -o d.png --json
grep -q '"most":[1-9]' out || fail "two media do not differ"
expect 0 relight-preview open --env sky.hdr --try skin1 --try skin1 --difference --size 64x48 -o d.png --json
grep -q '"most":0,' out || fail "a picture differs from itself"
expect 2 relight-preview open --env sky.hdr --try skin1 --difference -o d.png
expect 2 relight-preview open --env sky.hdr --try skin1 --frames 2 -o d.png
if command -v ffprobe >/dev/null; then
    for film in turn.mp4 turn.webm; do
        expect 0 relight-preview ball --env sky.hdr --frames 5 --size 64x48 -o $film
        [ "$(ffprobe -loglevel error -count_frames -show_entries stream=width,height,nb_read_frames \
            -of csv=p=0 $film)" = 64,48,5 ] || fail "$film is no film of five frames"
    done
fi
mkdir none
PATH=$dir/none /usr/bin/timeout 100 "$bin/relight-preview" ball --env sky.hdr --size 64x48 -o no.mp4 2>err
[ $? = 1 ] && grep -q 'ffmpeg' err || fail "a film without ffmpeg"
expect 1 relight-preview ball --env sky.hdr --size 63x48 -o no.mp4
# what cannot be written is an error that names it, by every command that writes
while read -r words; do
    # shellcheck disable=SC2086
    expect 1 $words
    grep -q "away/${words##*away/}" err || fail "no file named: $words: $(cat err)"
done <<'END'
relight colors ball --env sky.hdr -o away/x.csv
relight image ball --env sky.hdr --size 8x8 -o away/x.png
relight image ball --env sky.hdr --size 8x8 -o away/x.exr
relight edit open --material ketchup --env sky.hdr -o away/x.npy
relight edit open --material ketchup --env sky.hdr --size 8x8 -o away/x.png
relight room backup -o away/x.sqlite
relight-preview ball --env sky.hdr --size 8x8 -o away/x.png
prt material marble -o away/x.json
prt env sky.hdr -o away/x.exr
prt image ball.obj --material marble --size-mm 20 --env constant --size 8x8 --engine texture -o away/x.png
prt bake ball.obj --material marble --size-mm 20 --samples 300 --cube 16 -o away/x.prt
END
expect 2 relight-preview ball --env sky.hdr --size 0x4 -o x.png
expect 1 relight-preview ball --env nothing.hdr -o x.png
expect 3 relight-preview -s unix:"$dir"/none ball --env sky.hdr -o x.png

# textures: the daemon's picture is the client's, which fetches them, by the bake and without one
PYTHONPATH=$tests/../unit python3 -c '
from textured_ball import glb, png
rows = [[(250, 40 + 25 * y, 30 * x) for x in range(8)] for y in range(8)]
waves = [[(128 + 60 * (x % 2 * 2 - 1), 128, 220) for x in range(8)] for y in range(8)]
glb("painted.glb", [png(8, 8, rows), png(8, 8, waves)],
    {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "normalTexture": {"index": 1}},
    opaque=True)'
expect 0 relight load painted.glb --opaque stone --material marble --samples 4000 --cube 16 --wait --name painted
expect 0 relight image painted --env sky.hdr --size 160x120 -o daemon.exr
expect 0 relight-preview painted --env sky.hdr --size 160x120 --format f32 -o client.exr
same client.exr daemon.exr 0.005
expect 0 relight-preview painted --env sky.hdr --size 160x120 --no-textures -o plain.exr
"$bin/prt" compare plain.exr daemon.exr --max-rmse 0.1 >out 2>&1 && fail "--no-textures draws textures"
expect 0 relight load painted.glb --opaque stone --material marble --preview --name sketch
expect 0 relight image sketch --env sky.hdr --size 160x120 --engine tangent --term multiple -o draft.exr
expect 0 relight image painted --env sky.hdr --size 160x120 --term multiple -o daemon.exr
same draft.exr daemon.exr 0.1

# without a bake
expect 0 relight load ball.obj --size-mm 20 --material marble --preview --name draft --json
grep -q '"state":"preview"' out || fail "load --preview is not a preview"
expect 0 relight image draft --env sky.hdr --size 160x120 -o draft.exr --json
grep -q '"engine":"\(splat\|tangent\|texture\|hybrid\)".*"note":"preview' out || fail "no image-space engine"
grep -q '"error_bound":0\.' out || fail "no expected error"
expect 0 relight image draft --env sky.hdr --size 160x120 --engine hybrid --background 0,0,0 -o draft.exr
expect 0 prt image ball.obj --size-mm 20 --material marble --engine hybrid --scattering dipole --env sky.hdr \
    --size 160x120 --background 0,0,0 -o own.exr
same draft.exr own.exr 0.03
expect 1 relight colors draft --env sky.hdr -o x.csv
expect 0 relight geometry draft --own-units -o at.npy
expect 0 relight update-vertices draft --own-units --positions at.npy --json
grep -q '"vertices":830,"generation":2' out || fail "update-vertices does not say what it moved"
expect 0 relight image draft --env sky.hdr --size 160x120 --engine hybrid --background 0,0,0 -o moved.exr
grep -q 'vertices moved' err || fail "moved vertices are not told"
same moved.exr draft.exr 0.03
expect 1 relight update-vertices draft --positions sky.hdr
expect 2 relight update-vertices draft
expect 2 relight update-vertices draft --positions at.npy --first 1
expect 0 relight unload draft --forget
printf 'glTF and no more' >bad.glb
expect 1 relight load bad.glb --size-mm 20 --material marble --preview
grep -q 'bad.glb' err || fail "a broken model is not named"

kill -TERM "$daemon"
wait "$daemon"
got=$?
daemon=
[ $got = 0 ] || fail "SIGTERM: the daemon ended with status $got"
if grep -E 'Sanitizer: |: runtime error: ' daemon.log; then fail "a sanitizer's report"; fi
echo "all as expected"
