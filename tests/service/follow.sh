#!/bin/bash
# SPDX-License-Identifier: MIT
# relight-preview --follow against a live daemon: a picture of a room now and after each change, an
# undo and a hand that is not at rest among them; each is the daemon's own picture of the scene.
#   follow.sh BIN ROOM_HAND
set -u
export LC_ALL=C USER=ann
bin=${1:?the folder of the programs} hand=${2:?the program room_hand}
here=$(cd "$(dirname "$0")" && pwd)
dir=$(mktemp -d)
cd "$dir" || exit 1
daemon='' preview=''
finish() {
    for p in $daemon $preview; do kill "$p" 2>/dev/null; done
    wait
    rm -rf "$dir"
}
trap finish EXIT
fail() {
    echo "FAIL: $*"
    tail -n 6 out err log followed errors errors.hand 2>/dev/null | sed 's/^/    /'
    exit 1
}
relight() {
    timeout 300 "$bin/relight" -s "unix:$dir/s" "$@" >out 2>err </dev/null || fail "relight $*"
}
# followed N: N pictures were written.
followed() {
    for _ in $(seq ${TRIES:-6000}); do
        [ "$(wc -l <followed)" -ge "$1" ] && return
        kill -0 "$preview" 2>/dev/null || fail "relight-preview ended before picture $1"
        sleep 0.05
    done
    fail "picture $1 does not come"
}
follow() {
    : >followed
    "$bin/relight-preview" -s "unix:$dir/s" --size 96x64 --follow "$@" >followed 2>errors </dev/null &
    preview=$!
}
# A room's picture has levels between those of 8 bits.
same() { python3 "$here/picture_difference.py" "$1" "$2" 0 || fail "$1 is not $2"; }

printf 'v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n' >small.obj
printf 'f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n' >>small.obj
: >log
"$bin/relightd" --preview-walks=no --data "$dir/data" --models "$dir" --listen "unix:$dir/s" 2>>log &
daemon=$!
for _ in $(seq 1200); do
    grep -q ' start version' log && break
    sleep 0.05
done
relight load small.obj --remote --size-mm 20 --material marble --wait --samples 1000
relight room create 'First review' --model small --env constant:1,1,1 --exposure 1 --size 96x64
relight room show 'First review' -o first.png

# ---- now, a change, its undo
follow 'First review' -o live.png --frames 3
followed 1
same live-0001.png first.png
relight room scene 'First review' --env constant:1,0.5,0.2 --camera 0,0,5:0,0,0
relight room show 'First review' -o second.png
followed 2
same live-0002.png second.png
relight room undo 'First review'
wait "$preview" || fail "status $?: $(cat errors)"
same live-0003.png first.png
cmp -s first.png second.png && fail "the two scenes look alike"

# ---- a scene that the daemon does not draw: the next one is
follow 'First review' -o refused.png --frames 2
followed 1
relight room scene 'First review' --max-error 1e-9
for _ in $(seq 1200); do
    grep -q 'above max_error' errors && break
    sleep 0.05
done
relight room undo 'First review'
wait "$preview" || fail "status $? after a refused scene: $(cat errors)"
same refused-0002.png first.png

# ---- a hand, and a cursor, which changes no picture; an end by a signal
room=$("$bin/relight" -s "unix:$dir/s" room list --json | grep -o '"room": *"[0-9a-f]*"' | grep -o '[0-9a-f]\{32\}')
follow "${room:0:8}" -o hand.png --json
followed 1
mkfifo says
"$hand" "unix:$dir/s" "$room" <says 2>errors.hand &
exec 7>says
echo '{"name":"Hand","cursor":{"triangle":1}}' >&7
echo '{"name":"Hand","hand":{"lights":[{"env":"constant:1,0.5,0.2"}],"camera":{"eye":{"x":0,"y":0,"z":5},"target":{"x":0,"y":0,"z":0}}},"hand_parts":["lights","camera"]}' >&7
followed 2
same hand-0002.png second.png
exec 7>&- # the hand is gone, and the scene as it was
followed 3
same hand-0003.png first.png
kill -TERM "$preview"
wait "$preview" || fail "status $? after SIGTERM: $(cat errors)"
[ "$(wc -l <followed)" = 3 ] || fail "a cursor makes pictures: $(cat followed)"
[ ! -s errors.hand ] || fail "$(cat errors.hand)"

# ---- a camera by orbit
relight room scene 'First review' --orbit 30,40,2
relight room show 'First review' -o third.png
cmp -s third.png first.png && fail "the orbit changes nothing"
follow 'First review' -o orbit.png --frames 1
wait "$preview" || fail "status $?: $(cat errors)"
same orbit-0001.png third.png

# ---- another variant of the file
PYTHONPATH=$here/../unit python3 -c 'import variant_model; variant_model.write("v.glb")'
relight load v.glb --remote --size-mm 20 --preview
relight room create Variants --model v --env constant:1,1,1 --size 96x64
relight room show Variants -o own.png
relight room act Variants '{"scene":{"parts":["shade"],"scene":{"shade":{"variant":"day","engine":"splat"}}}}'
relight room show Variants -o day.png
cmp -s own.png day.png && fail "the variant changes nothing"
follow Variants -o variant.png --frames 1
wait "$preview" || fail "status $?: $(cat errors)"
same variant-0001.png day.png

# ---- an ending in capitals; a name that JSON escapes
follow 'First review' -o capital.EXR --frames 1
wait "$preview" || fail "status $?: $(cat errors)"
[ "$(head -c 4 capital-0001.EXR | od -An -tx1)" = ' 76 2f 31 01' ] || fail "capital-0001.EXR is no EXR"
follow 'First review' -o 'a "name".png' --frames 1 --json
wait "$preview" || fail "status $?: $(cat errors)"
python3 -c 'import json; assert json.load(open("followed"))["file"] == "a \"name\"-0001.png"' || fail "$(cat followed)"

# ---- a film; wrong words
# Frames on their way to ffmpeg, counted by a program of its name.
mkdir fake
printf '#!/bin/sh\nexec wc -c >counted\n' >fake/ffmpeg
chmod +x fake/ffmpeg
PATH=$dir/fake:$PATH follow 'First review' -o live.mp4 --frames 1
wait "$preview" || fail "status $?: $(cat errors)"
[ "$(cat counted)" = $((96 * 64 * 3)) ] || fail "a film of $(cat counted) bytes"
# Ctrl-C reaches every program of the terminal's group, and ends the film, not ffmpeg.
cat >fake/ffmpeg <<'END'
#!/bin/sh
trap 'exit 255' INT
head -c 4096 >/dev/null && : >begun
wc -c >counted
END
python3 - "$bin/relight-preview" -s "unix:$dir/s" --size 96x64 --follow 'First review' -o live.mp4 <<'END' || fail "Ctrl-C ends no film"
import os, signal, subprocess, sys, time
os.environ['PATH'] = os.path.abspath('fake') + ':' + os.environ['PATH']
preview = subprocess.Popen(sys.argv[1:], start_new_session=True)
for _ in range(1200):
    if os.path.exists('begun') or preview.poll() is not None:
        break
    time.sleep(.05)
os.killpg(preview.pid, signal.SIGINT)
sys.exit(preview.wait(60))
END
wrong() { # STATUS TEXT ARGUMENTS...
    local want=$1 text=$2
    shift 2
    timeout 100 "$bin/relight-preview" -s "unix:$dir/s" "$@" >out 2>err </dev/null
    [ $? = "$want" ] && grep -q -- "$text" err || fail "not $want with \"$text\": relight-preview $*"
}
wrong 1 'no such room' --follow nowhere -o x.png
wrong 2 'the room has the model' --follow 'First review' --env constant -o x.png
for option in --exposure=1 --tone=none --background=1,1,1 --rotate=20 --no-specular --no-textures --samples-per-pixel=1; do
    wrong 2 'camera and picture' --follow 'First review' $option -o x.png
done
wrong 2 'no --sheet' --follow 'First review' --sheet -o x.png
wrong 2 'the daemon writes .jpg, .png, .exr' --follow 'First review' -o x.hdr
wrong 2 'the daemon writes .jpg, .png, .exr' --follow 'First review' -o x.HDR
wrong 2 'ID is missing' -o x.png
wrong 2 'has to end in .png' nothing --env constant --env constant --difference -o x.png.jpg
wrong 1 'nothing' nothing --env constant --env constant --difference -o X.PNG
preview=
kill -TERM "$daemon"
wait "$daemon" || fail "status $? of the daemon"
daemon=
if grep -E 'Sanitizer: |: runtime error: ' log; then fail "a sanitizer's report"; fi
