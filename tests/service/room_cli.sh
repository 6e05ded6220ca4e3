#!/bin/bash
# SPDX-License-Identifier: MIT
# relight room against a live daemon: a review from its beginning to its export. A pin is drawn
# again with the same bytes, also after a restart; the BCF file comes back by our own import.
#   room_cli.sh BIN SCHEMAS [bcf]     bcf: only the check of the BCF file against its schemas
set -u
export LC_ALL=C USER=ann
bin=${1:?the folder of the programs} schemas=$2 only=${3-}
if [ -n "$only" ] && { [ ! -f "$schemas/markup.xsd" ] || ! command -v xmllint >/dev/null || ! command -v unzip >/dev/null; }; then
    echo "skipped: $schemas/markup.xsd, xmllint or unzip is not there"
    [ "${PRT_REQUIRE_DATA-}" != 1 ] || exit 1
    exit 77
fi
here=$(cd "$(dirname "$0")" && pwd)
dir=$(mktemp -d)
cd "$dir" || exit 1
daemon=
watchers=
finish() {
    # shellcheck disable=SC2086 # words
    [ -z "$daemon$watchers" ] || kill $daemon $watchers 2>/dev/null
    rm -rf "$dir"
}
trap finish EXIT
fail() {
    echo "FAIL: $*"
    tail -n 6 out err log 2>/dev/null | sed 's/^/    /'
    exit 1
}
expect() { # STATUS ARGUMENTS...
    local want=$1 got
    shift
    timeout 100 "$bin/relight" -s "unix:$dir/s" "$@" >out 2>err </dev/null
    got=$?
    [ $got = "$want" ] || fail "status $got, not $want: relight $*"
}
says() { grep -q -- "$1" out err || fail "no \"$1\" in: $(cat out err)"; }
no_reports() { # a sanitizer's, of the daemon or of a child
    grep -qsE 'Sanitizer: |: runtime error: ' log || return 0
    cat log
    fail "a sanitizer's report"
}
start() {
    no_reports
    : >log
    "$bin/relightd" --preview-walks=no --data "$dir/data" --models "$dir" --listen "unix:$dir/s" "$@" 2>>log &
    daemon=$!
    for _ in $(seq 1200); do
        grep -q ' start version' log && return
        sleep 0.05
    done
    fail "the daemon does not start"
}
printf 'v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n' >small.obj
printf 'f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n' >>small.obj
start
expect 0 load small.obj --remote --size-mm 20 --material marble --wait --samples 1000

# ---- a review
room='Ball, in "jade"'
expect 0 room create "$room" --model small --env constant:1,1,1 --exposure 1 --size 96x64
expect 0 room pin "$room" 'too red, @Bob
second line & <b>' --at 0,2,0.3,0.2
expect 0 room pin "$room" '=1+1' --at 0,3,0.3,0.2 --as Bob
expect 0 room reply "$room" 2 'I see it' --as Bob
expect 0 room resolve "$room" 3
expect 0 room approve "$room" '=cmd()'
expect 0 room show "$room" 2 -o first.png
expect 0 room scene "$room" --env constant:1,0.5,0.2 --camera 0,0,5:0,0,0
expect 0 room show "$room" -o now.png
cmp -s first.png now.png && fail "the pin's picture is that of the scene now"
expect 0 room show "$room"
says 'approved at revision 1, changed since: =cmd()'
expect 0 room save "$room"
expect 0 room show "$room"
says 'approved at revision 1, now at 2'
expect 0 room undo "$room"
expect 0 room show "$room" -o undone.png
cmp first.png undone.png || fail "undo does not bring the scene back"

# ---- a scene that changed: in numbers, and as pictures
expect 0 room scene "$room" --env constant:1,0.5,0.2
expect 0 room save "$room" redder
expect 0 room compare "$room" -o changed.png
says 'approved by ann at revision 1, now at 3: dE2000 mean'
expect 0 room compare "$room" 1 1 --json
says '"mean":0,.*"max":0,"changed":0'
expect 0 room compare "$room" 1 3 --json
says '"mean":1[0-9]'
size() { python3 -c 'import sys, struct; print("%ux%u" % struct.unpack(">II", open(sys.argv[1], "rb").read(24)[16:]))' "$1"; }
[ "$(size changed.png)" = 196x132 ] || fail "the sheet is $(size changed.png)"
for layout in side:196x64 wipe:96x64 delta:96x64; do
    expect 0 room compare "$room" 1 3 --layout ${layout%:*} -o layout.png
    [ "$(size layout.png)" = ${layout#*:} ] || fail "${layout%:*} is $(size layout.png)"
done
# The second picture has the size of the first, whatever size its scene has.
expect 0 room create sizes --model small --env constant --size 96x64
expect 0 room save sizes
expect 0 room scene sizes --size 40x30
expect 0 room save sizes
expect 0 room compare sizes 1 2 --layout side -o layout.png
[ "$(size layout.png)" = 196x64 ] || fail "pictures of two sizes are $(size layout.png)"
# Each light has its own turn and gain; one that comes once is that of all.
lights() {
    expect 0 room scene sizes --env constant --env constant:1,0,0 "${@:2}"
    expect 0 room show sizes --json
    python3 -c 'import json, sys
print([(l.get("rotate_deg", 0), *(l["gain"][k] for k in "xyz")) for l in json.load(open("out"))["scene"]["lights"]])' >lights
    [ "$(cat lights)" = "$1" ] || fail "$(cat lights) are not the lights of ${*:2}"
}
lights '[(0, 2, 2, 2), (0, 3, 4, 5)]' --gain 2 --gain 3,4,5
lights '[(10, 2, 2, 2), (20, 2, 2, 2)]' --rotate 10 --rotate 20 --gain 2
lights '[(10, 2, 2, 2), (10, 3, 3, 3)]' --rotate 10 --gain 2 --gain 3
expect 2 room compare "$room" one && says "a revision's number"
expect 1 room compare "$room" 99 && says 'no such pin, decision or revision' && says 'relight room show'
expect 0 room undo "$room"

# ---- pins on another model: a finer one of the same shape, a moved one, one far away
awk 'BEGIN { split("1 0 0 -1 0 0 0 1 0 0 -1 0 0 0 1 0 0 -1", p, " "); split("1 3 5 3 2 5 2 4 5 4 1 5 3 1 6 2 3 6 4 2 6 1 4 6", f, " ")
    n = 0; for (t = 0; t < 8; t++) { for (i = 1; i <= 3; i++) for (k = 1; k <= 3; k++) v[i, k] = p[(f[3*t + i] - 1)*3 + k]
        for (k = 1; k <= 3; k++) { m[1, k] = (v[1, k] + v[2, k])/2; m[2, k] = (v[2, k] + v[3, k])/2; m[3, k] = (v[3, k] + v[1, k])/2 }
        for (i = 1; i <= 3; i++) print "v", v[i, 1], v[i, 2], v[i, 3]
        for (i = 1; i <= 3; i++) print "v", m[i, 1], m[i, 2], m[i, 3]
        print "f", n+1, n+4, n+6; print "f", n+2, n+5, n+4; print "f", n+3, n+6, n+5; print "f", n+4, n+5, n+6; n += 6 } }' >fine.obj
sed 's/^v \([^ ]*\)/v 1\1/; s/^v 1-1/v 9/; s/^v 1\([01]\) /v 1\1 /' small.obj >far.obj
expect 0 room anchors "$room"
says 'pin 2  on its triangle, as it was'
# Another bake of the same shape has the same triangles.
expect 0 load small.obj --remote --name twin --size-mm 20 --material wholemilk --wait --samples 1000
expect 0 room scene "$room" --model twin
expect 0 room anchors "$room"
says 'pin 2  on its triangle, as it was'
# So has a preview: a pin goes from a bake to it, and from it to a bake.
expect 0 load small.obj --remote --name early --size-mm 20 --material skin1 --preview
expect 0 room scene "$room" --model early
expect 0 room anchors "$room"
says 'pin 2  on its triangle, as it was'
expect 0 room create early --model early --env constant --size 96x64
expect 0 room pin early 'before the bake' --at 0,5,0.3,0.2
expect 0 room show early 2 --json
grep -q '"mesh_hash":"[0-9a-f]\{16\}"' out && ! grep -q bake_hash out || fail "the preview's pin: $(cat out)"
expect 0 room scene early --model twin
expect 0 room anchors early
says 'pin 2  on its triangle, as it was'
# A decision is about the bake that was seen: a bake that replaces its preview is told, and one
# that replaces a bake.
expect 0 load small.obj --remote --name later --size-mm 20 --material ketchup --samples 1000 --preview
expect 0 room create later --model later --env constant --size 96x64
expect 0 room approve later 'of the preview'
expect 0 room show later
says 'approved at revision 1: of the preview'
expect 0 room export later -o later
[ ! -e later/pictures/decision-2-now.png ] || fail "a picture of a change that is none"
expect 0 load small.obj --remote --name later --size-mm 20 --material ketchup --samples 1000 --wait
expect 0 room show later
says 'approved at revision 1; the model was baked since: of the preview'
expect 0 room compare later
says 'approved by ann at revision 1, now at 1; the model was baked since: dE2000 mean'
expect 0 room export later -o later
[ -s later/pictures/decision-2-now.png ] || fail "no picture of what the bake changed"
expect 0 room reject later 'of the bake'
expect 0 room show later
says 'rejected at revision 1: of the bake'
expect 0 info later --json
grep -q '"mesh_hash":"[0-9a-f]\{16\}","bake_hash":"[0-9a-f]\{16\}"' out || fail "the model's hashes: $(cat out)"
expect 2 unload later --forget
says 'later: 1 review room needs it: [0-9a-f]\{32\}'
expect 2 unload later --force
says '--force is for --forget'
expect 0 room pin later 'of the bake, too' --at 0,2,0.3,0.2
expect 0 unload later --forget --force
expect 0 room show later
says 'rejected at revision 1: of the bake'
# What cannot be drawn any more is left out, and the rest is exported.
rm -r later
expect 1 room export later -o later
says 'pictures/pin-4.png is left out: '
says 'pictures/decision-2.png is left out: '
says 'the view of pin 4 in pins.bcf is left out: '
says 'the export is not complete: 4 parts are left out'
[ "$(wc -l <later/decisions.csv)" = 3 ] && [ -s later/history.json ] || fail "the rest of the export: $(ls later)"
python3 - <<'END' || fail "a pin without a view in pins.bcf"
import xml.etree.ElementTree as tree, zipfile
with zipfile.ZipFile('later/pins.bcf') as z:
    assert len(z.namelist()) == 4, z.namelist()
    markup = tree.fromstring(z.read([n for n in z.namelist() if n.endswith('markup.bcf')][0]))
assert markup.find('Topic/Title').text == 'of the bake, too' and not markup.findall('.//Viewpoint')
END
# The same bake again has the same bytes. A file with another bake of the shape takes its place.
expect 0 load small.obj --remote --name later --size-mm 20 --material ketchup --samples 1000 --wait
expect 0 room show later
says 'rejected at revision 1: of the bake'
file_of() { "$bin/relight" -s "unix:$dir/s" info "$1" --json | sed 's/.*"model":"\([0-9a-f]*\)".*/data\/bakes\/\1.prt/'; }
of_small=$(file_of small) of_later=$(file_of later)
kill $daemon && wait $daemon || fail "the daemon's end"
cp "$of_small" "$of_later" || fail "no bake of the models"
start
expect 0 room show later
says 'rejected at revision 1; the model was baked anew since: of the bake'
expect 0 room scene later --exposure 2
expect 0 room show later
says 'rejected at revision 1, changed since; the model was baked anew since: of the bake'
# A change of a picture or shade keeps what it does not name.
expect 0 room scene later --size 80x60 --background transparent
expect 0 room scene later --term multiple
expect 0 room scene later --variant default
expect 0 room show later --json
python3 - out <<'END' || fail "the scene: $(cat out)"
import json, sys
scene = json.load(open(sys.argv[1]))['scene']
p, s = scene['picture'], scene['shade']
assert (p['width'], p['exposure_ev'], p['transparent'], s['term'], s['variant']) == (80, 2, True, 'multiple', 'default')
END
expect 0 room scene later --engine splat
expect 0 room show later --json
says '"engine":"splat"'
expect 0 room scene later --engine default
expect 0 room show later --json
says '"engine":"default"'
expect 0 room scene later --exposure 0 --background 1,1,1
expect 0 room show later --json
python3 - out <<'END' || fail "the scene: $(cat out)"
import json, sys
p = json.load(open(sys.argv[1]))['scene']['picture']
assert p['width'] == 80 and not p.get('exposure_ev') and not p.get('transparent') and p['plain_background'], p
END
expect 0 load fine.obj --remote --size-mm 20 --material marble --preview
expect 0 room scene "$room" --model fine
expect 0 room anchors "$room"
says 'pin 2  on the nearest surface, 0.000 % of'
expect 0 room anchors "$room" --json
python3 - out <<'END' || fail "the pins' places on the finer model: $(cat out)"
import json, sys
for line in open(sys.argv[1]):
    a = json.loads(line)
    assert a['state'] == 'placed' and a['distance'] < 1e-6, a
    p = a['at']['position']
    assert abs(abs(p['x']) + abs(p['y']) + abs(p['z']) - 1) < 1e-5, p  # on the octahedron
    assert a['at']['object'] == 0 and a['at']['triangle'] < 32, a
END
expect 0 load far.obj --remote --size-mm 20 --material marble --preview
expect 0 room scene "$room" --model far
expect 0 room anchors "$room"
says 'pin 2  cannot be placed: the nearest surface is'
expect 0 room scene "$room" --model small
expect 0 room show "$room" -o undone.png
cmp first.png undone.png || fail "the first model is not drawn as it was"
expect 0 room act "$room" '{"stroke": {"pin": 2, "color": 16711680, "width": 3, "points": [
    {"triangle": 0, "position": {"x": 0.6, "y": 0.2, "z": 0.2}}, {"triangle": 0, "position": {"x": 0.2, "y": 0.6, "z": 0.2}}]}}'
expect 2 room act "$room" nonsense && says 'RoomAction'

# ---- watching: who comes and who goes
if [ -z "$only" ]; then
    watch() { "$bin/relight" -s "unix:$dir/s" room watch "$room" >"$1" 2>&1 </dev/null & }
    seen() { # N TEXT: watch1 has N lines of it
        for _ in $(seq 400); do
            [ "$(grep -c "$2" watch1)" -ge "$1" ] && return
            sleep 0.05
        done
        fail "fewer than $1 lines of \"$2\": $(cat watch1)"
    }
    watch watch1
    watchers=$!
    seen 1 'participant [0-9]*: ann'
    watch watch2
    watchers="$watchers $!"
    seen 2 'participant [0-9]*: ann'
    kill $! && seen 1 'participant [0-9]* left$'
    kill ${watchers% *}
    wait $watchers
    watchers=
fi

# ---- mistakes have their remedy
expect 2 room frown "$room" && says 'expected one of create'
expect 2 room pin "$room" && says 'relight room pin ROOM TEXT'
expect 1 room show nowhere && says 'relight room list'
# A room's id may be cut to four digits, not to three.
id=$("$bin/relight" -s "unix:$dir/s" room list --json | sed 's/.*"room":"\([0-9a-f]*\)".*/\1/')
expect 0 room show "$(echo "$id" | cut -c1-8)"
expect 1 room show "$(echo "$id" | cut -c1-3)" && says 'relight room list'
expect 2 room pin "$room" text --at 0,0,2,2 && says 'weights'
expect 1 room resolve "$room" 77 && says 'no pin 77' && says 'relight room show'
expect 2 room resolve "$room" seven && says 'expected a number'
expect 2 room show "$room" 0 -o zero.png && says "0: expected a pin's number"
expect 2 room resolve "$room" 3 && says 'resolved already' && says 'relight room show'
expect 1 room rename "$room" "$(printf 'x%.0s' $(seq 121))" && says 'every review room has this bound'

# ---- export: the decision's picture is what its hash says
if [ -z "$only" ]; then
    expect 0 room export "$room" -o export
    hash=$(sha256sum <first.png | cut -c1-64)
    grep -q "\"$hash\"" export/decisions.csv || fail "the decision's picture hash"
    cmp first.png export/pictures/pin-2.png || fail "the picture of the pin"
    cmp -s export/pictures/pin-2.png export/pictures/pin-2-strokes.png && fail "the stroke is not drawn"
    # From the lower right to the upper left, right of the middle and above it, and red.
    python3 - "$here" <<'END' || fail "the stroke is drawn elsewhere, or in another colour"
import sys
sys.path.insert(0, sys.argv[1])
from picture_difference import read_png
w, h, before = read_png('export/pictures/pin-2.png')
drawn = read_png('export/pictures/pin-2-strokes.png')[2]
at = [(x, y) for y in range(h) for x in range(w)
      if max(abs(a - b) for a, b in zip(before[y][x], drawn[y][x])) > 1]
colors = {drawn[y][x] for x, y in at}
assert colors == {(255, 0, 0)}, (len(at), sorted(colors)[:9])
x, y = (sum(p) / len(at) for p in zip(*at))
assert w / 2 < x and y < h / 2 and max(at)[1] > min(at)[1] + 3, (x, y, min(at), max(at))
END
    [ ! -e export/pictures/pin-3-strokes.png ] || fail "a picture of strokes that are not there"
    # No cell is a formula for a spreadsheet.
    ! grep -E '(^|,)"[=+@-]' export/decisions.csv || fail "a formula in decisions.csv"
    python3 - <<'END' || fail "the exported material"
import json, math, re
m = json.load(open('export/material.json'))
g = json.load(open('export/material.gltf'))['materials'][0]['extensions']
v, s = g['KHR_materials_volume'], g['KHR_materials_volume_scatter']
x = open('export/material.mtlx').read()
radius = [float(t) for t in re.search(r'subsurface_radius.*value="([^"]*)"', x).group(1).split(',')]
for c in range(3):
    sigma_t = m['sigma_s_prime'][c] / (1 - m['g'][c]) + m['sigma_a'][c]
    # Beer and Lambert over one distance, which glTF has in metres.
    assert abs(v['attenuationColor'][c] - math.exp(-sigma_t * v['attenuationDistance'] * 1e3)) < 1e-5
    assert abs(radius[c] * (m['sigma_s_prime'][c] + m['sigma_a'][c]) - 1) < 1e-5
    assert 0.7 < s['multiscatterColor'][c] < 0.9 # marble
r = json.load(open('export/room.json'))
h = json.load(open('export/history.json'))
assert len(h) == r['sequence'] and [e['stamp']['sequence'] for e in h] == list(range(1, len(h) + 1))
END
    # A later export into the same folder leaves nothing behind that the room does not have.
    expect 0 room create again --model small --env constant --size 96x64
    expect 0 room approve again
    expect 0 room pin again 'to be erased' --at 0,2,0.3,0.2
    expect 0 room scene again --env constant:1,0.5,0.2
    expect 0 room export again -o again
    ours='pictures/decision-2-now.png pictures/pin-3.png material.json material.gltf material.mtlx'
    for file in $ours; do [ -s "again/$file" ] || fail "again/$file: $(ls again/*)"; done
    touch again/pictures/pin.png again/materials.json
    expect 0 room undo again
    expect 0 room erase again 3
    expect 0 room reject again
    expect 0 room export again -o again
    for file in $ours; do [ ! -e "again/$file" ] || fail "again/$file of the export before"; done
    [ -e again/pictures/pin.png ] && [ -e again/materials.json ] || fail "another's files: $(ls again/*)"
    # Media by object are exported each for itself.
    # Two names of objects agree in the letters that fit into a file's name; one is like another's
    # with its number.
    long=$(printf 'L%.0s' $(seq 60))
    { echo 'o Ball 1'; cat small.obj; echo "o ${long}a"; awk '/^f/ { $2 += 6; $3 += 6; $4 += 6 } { print }' small.obj
        echo "o ${long}b"; awk '/^f/ { $2 += 12; $3 += 12; $4 += 12 } { print }' small.obj
        echo 'o Ball_1-1'; awk '/^f/ { $2 += 18; $3 += 18; $4 += 18 } { print }' small.obj; } >parts.obj
    expect 0 load parts.obj --remote --size-mm 20 --material marble --preview
    expect 0 room create media --model parts --env constant --size 96x64
    own='{"name":"own","sigma_s_prime":[1,2,3],"sigma_a":[0.1,0.01,0.1],"g":0.2,"eta":1.35,"roughness":0.15}'
    expect 0 room scene media --material 'Ball 1=skin1' --material "${long}a=$own" --material "${long}b=ketchup" \
        --material Ball_1-1=wholemilk
    expect 0 room scene media --engine texture # the medium stays
    expect 0 room scene media --max-error 0.25 --budget-ms 900
    expect 0 room show media --json
    says "\"budget_ms\":900"
    says "\"max_error\":0.25"
    says "\"materials\":\[{"
    expect 0 room scene media --engine texture
    expect 0 room approve media '@SUM(1)'
    expect 0 room export media -o media
    grep -q "\"'@SUM(1)\"" media/decisions.csv || fail "a formula in decisions.csv: $(cat media/decisions.csv)"
    for name in material material-Ball_1+1 material-Ball_1-1 "material-$long+2" "material-$long+3"; do
        for kind in json gltf mtlx; do [ -s "media/$name.$kind" ] || fail "media/$name.$kind: $(ls media)"; done
    done
    grep -q 'skin1' media/material-Ball_1+1.json && grep -q 'marble' media/material.json ||
        fail "the media of objects: $(cat media/material*.json)"
    # Each of a medium's three files says the same of it.
    python3 - <<'END' || fail "an exported medium"
import glob, json, re
for path in glob.glob('media/material*.json'):
    m = json.load(open(path))
    g = json.load(open(path[:-4] + 'gltf'))['materials'][0]
    x = dict(re.findall(r'name="([a-z_A-Z]+)" type="float" value="([^"]*)"', open(path[:-4] + 'mtlx').read()))
    e = g['extensions']
    for what, want, *got in (
            ('roughness', m['roughness'], g['pbrMetallicRoughness']['roughnessFactor'], x['specular_roughness']),
            ('eta', m['eta'], e['KHR_materials_ior']['ior'], x['specular_IOR']),
            ('g', m['g'][1], e['KHR_materials_volume_scatter']['scatterAnisotropy'], x['subsurface_anisotropy'])):
        assert all(abs(float(v) - want) < 1e-6 for v in got), (path, what, want, got)
END
    # ---- the same bytes over a restart, and from a copy of the store
    expect 0 room backup -o copy.sqlite
    expect 0 room backup -o copy.sqlite --json
    says "\"bytes\":$(stat -c %s copy.sqlite)"
    kill -KILL $daemon && wait $daemon 2>/dev/null
    start --rooms "sqlite:$dir/copy.sqlite"
    expect 0 room show "$room" 2 -o again.png --json
    says '"file":"again.png","width":'
    cmp first.png again.png || fail "the picture of a pin differs after a restart"
    # On another instruction set it is the same to the eye.
    for isa in c avx2; do
        kill $daemon && wait $daemon || fail "the daemon's end"
        start --rooms "sqlite:$dir/copy.sqlite" --cpu $isa
        expect 0 room show "$room" 2 -o $isa.png
        python3 "$here/picture_difference.py" first.png $isa.png 0.5 ||
            fail "the picture of a pin differs with --cpu $isa"
    done
    kill $daemon && wait $daemon || fail "the daemon's end"
    start --rooms "sqlite:$dir/copy.sqlite" # pictures are compared by their bytes from here on
fi

# ---- BCF
expect 0 room export "$room" -o export
expect 0 room create copy
expect 0 room import copy export/pins.bcf
says '2 pins'
expect 0 room show copy
says 'too red, @Bob'
says 'resolved'
expect 0 room show copy 2
says 'I see it'
expect 0 room show copy 2 -o imported.png
cmp first.png imported.png || fail "the imported pin shows another picture"
expect 0 room export copy -o second
# Another program's file has no point of the surface, but views, of a model of 10 mm a unit: in
# metres with +z up.
python3 - <<'END' || fail "foreign.bcf"
import zipfile
def camera(kind, eye, direction, up, more):
    v = ''.join('<%s><X>%s</X><Y>%s</Y><Z>%s</Z></%s>' % (n, *x.split(), n) for n, x in
                (('CameraViewPoint', eye), ('CameraDirection', direction), ('CameraUpVector', up)))
    return '<VisualizationInfo Guid="v"><Components/><%s>%s%s</%s></VisualizationInfo>' % (kind, v, more, kind)
views = {
    'tilted': camera('PerspectiveCamera', '0.015 -0.02 0.01', '-1 1.8 -0.7', '0 0 1', '<FieldOfView>50</FieldOfView>'),
    'above': camera('OrthogonalCamera', '0.002 -0.003 0.5', '0 0 -1', '0 1 0', '<ViewToWorldScale>0.03</ViewToWorldScale>'),
    'past': camera('PerspectiveCamera', '0.05 -0.1 0', '0 1 0', '0 2 0', '<FieldOfView>75</FieldOfView>'),
    'lost': camera('PerspectiveCamera', 'nan 0 1e99', '0 0 0', '0 0 1', '<FieldOfView>-1</FieldOfView>'),
    'blind': None}
with zipfile.ZipFile('foreign.bcf', 'w', zipfile.ZIP_DEFLATED) as z:
    z.writestr('bcf.version', '<Version VersionId="2.1"/>')
    for name, view in views.items():
        part = '<Viewpoint>%s.bcfv</Viewpoint>' % name if view else ''
        comment = '<Comment Guid="c"><Comment>seen</Comment><Viewpoint Guid="v"/></Comment>'
        head = '<Title>%s</Title><CreationAuthor>x</CreationAuthor>' % name
        if name == 'past': # BCF 3.0 has comments and views inside the topic
            z.writestr(name + '/markup.bcf', '<Markup><Topic Guid="t">%s<Comments>%s</Comments><Viewpoints><ViewPoint Guid="v">'
                       '%s</ViewPoint></Viewpoints></Topic></Markup>' % (head, comment, part))
        else:
            part = '<Viewpoints Guid="v">%s</Viewpoints>' % part if view else ''
            z.writestr(name + '/markup.bcf', '<Markup><Topic Guid="t">%s</Topic>%s%s</Markup>' % (head, comment, part))
        if view: z.writestr('%s/%s.bcfv' % (name, name), view)
END
expect 0 load small.obj --remote --name ten --mm-per-unit 10 --material marble --preview
expect 0 room create foreign --model ten --env constant --size 96x64
expect 0 room import foreign foreign.bcf
says '^5 pins, placed by their view: 3$'
expect 0 room show foreign --json
python3 - out <<'END' || fail "the pins of another program: $(cat out)"
import json, math, sys
room = json.load(open(sys.argv[1]))
def near(a, b, what):
    got = [a.get(k, 0) for k in 'xyz']
    assert all(abs(g - w) < 1e-4 for g, w in zip(got, b)), (what, got, b)
def camera(pin):
    return room['revisions'][pin['seen']['revision'] - 1]['scene'].get('camera')
pins = {p['notes'][0]['text'].split('\n')[0]: p for p in room['pins']}
tilted, above, past = (pins[n] for n in ('tilted', 'above', 'past'))
near(tilted['at']['position'], (.5, .3, .2), 'tilted')
assert tilted['at'].get('triangle', 0) == 0 and abs(tilted['at']['b1'] - .3) < 1e-4 and abs(tilted['at']['b2'] - .2) < 1e-4
near(camera(tilted)['eye'], (1.5, 1, 2), 'eye')
near(camera(tilted)['target'], (.5, .3, .2), 'target')
near(camera(tilted)['up'], (0, 1, 0), 'up')
assert camera(tilted)['fovy_deg'] == 50
# A long lens: its angle spans the height of the view, 3 units, where the pin lies.
near(above['at']['position'], (.2, .5, .3), 'above')
near(camera(above)['up'], (0, 0, -1), 'up')
near(camera(above)['target'], (.2, .5, .3), 'target')
far = camera(above)['eye']['y'] - .5
assert abs(2*far*math.tan(math.radians(camera(above)['fovy_deg'])/2) - 3) < 1e-4, far
near(past['at']['position'], (1, 0, 0), 'past') # the nearest corner
near(camera(past)['eye'], (5, 0, 10), 'past')
near(camera(past)['up'], (0, 1, 0), 'an up along the view')
for name in ('lost', 'blind'):
    assert pins[name]['at'].get('triangle', 0) == 0 and camera(pins[name]) is None, name
assert all(p['notes'][1]['text'].startswith('seen') for p in room['pins'])
END
for pin in 2 4 6; do # each has a comment
    expect 0 room show foreign $pin -o foreign.png
done
# Their views go out in metres, too, also where the room shows a model of another scale by now.
expect 0 room export foreign -o outward
expect 0 room scene foreign --model small
expect 0 room export foreign -o afterwards
for file in outward/pins.bcf afterwards/pins.bcf; do
    python3 - $file <<'END' || fail "the views of $file"
import sys, xml.etree.ElementTree as tree, zipfile
with zipfile.ZipFile(sys.argv[1]) as z:
    views = [tree.fromstring(z.read(n)) for n in z.namelist() if n.endswith('.bcfv')]
eyes = [[float(v.find('.//CameraViewPoint/' + k).text) for k in 'XYZ'] for v in views]
for want in ((0.015, -0.02, 0.01), (0.05, -0.1, 0)):
    assert any(max(abs(g - w) for g, w in zip(eye, want)) < 1e-5 for eye in eyes), (want, eyes)
# A view's angle is the camera's, as far as the schema allows: one of 75 degrees, a long lens, one of 50; 36 without a camera.
angles = sorted(float(v.find('.//FieldOfView').text) for v in views)
assert len(angles) == 5 and min(angles) == 45 and max(angles) == 60 and angles.count(50) == 1 == angles.count(60), angles
END
done
expect 0 room create empty
expect 2 room import empty foreign.bcf && says 'no model to place pins on'
# A note that is too long is cut, and one topic that fails ends the import: both are told.
python3 - <<'END' || fail "long.bcf"
import zipfile
with zipfile.ZipFile('long.bcf', 'w') as z:
    for name in 'ab':
        z.writestr(name + '/markup.bcf', '<Markup><Topic Guid="t"><Title>%s</Title></Topic><Comment Guid="c"><Comment>%s'
                   '</Comment></Comment></Markup>' % (name, '\u00e4' * 4200))
    z.writestr('b/pin.json', '{"pin": {"at": {}}, "scene": {"model": "%032d"}}' % 0)
END
expect 0 room create long --model ten --env constant --size 96x64
expect 1 room import long long.bcf
says '1 of 2 topics are in the room as a whole'
says 'warning: 1 notes are cut: a room takes 8192 bytes'
expect 0 room show long --json
python3 - out <<'END' || fail "the note that was cut"
import json, sys
text = json.load(open(sys.argv[1]))['pins'][0]['notes'][1]['text']
assert 8190 <= len(text.encode()) <= 8192 and text.endswith('\u00e4\n(?, ?)'), (len(text.encode()), text[-9:])
END
head -c 3000 export/pins.bcf >cut.bcf
expect 1 room import copy cut.bcf && says 'zip'
# A title that is too long ends with a whole character.
expect 0 room create umlauts --model small --env constant:1,1,1 --size 96x64
expect 0 room pin umlauts "$(printf 'ä%.0s' $(seq 100))" --at 0,2,0.3,0.2
# A note may have what XML has not.
expect 0 room pin umlauts "$(printf 'no\357\277\277 character\001')" --at 0,2,0.3,0.2
expect 0 room export umlauts -o umlauts
expect 0 room import copy umlauts/pins.bcf
says '2 pins'
# A picture of a room in the terminal.
expect 0 room show umlauts -o - --size 8x4
[ ! -e - ] || fail "a file whose name is -"
grep -q "$(printf '\033')" out || fail "no picture in the terminal"
if [ -z "$only" ]; then
    # A list that is not whole says so: all rooms are younger than the first one by now.
    kill $daemon && wait $daemon || fail "the daemon's end"
    python3 - <<'END' || fail "1000 more rooms"
import sqlite3
with sqlite3.connect('copy.sqlite') as db:
    for i in range(1000):
        db.execute('INSERT INTO room (id, sequence, created_us, changed_us, name, owner, keeps) '
                   "VALUES ('%032x', 1, 1, 4000000000000000, 'many', 'uid:9', '')" % i)
END
    start --rooms "sqlite:$dir/copy.sqlite"
    expect 0 room list && says 'warning: these are the rooms that changed last; there are more'
    [ "$(wc -l <out)" = 1000 ] || fail "$(wc -l <out) rooms are listed"
    expect 1 room show umlauts && says "give the room's whole id"
fi
if [ -n "$only" ]; then
    for file in export second; do
        mkdir "u-$file" && (cd "u-$file" && unzip -q "../$file/pins.bcf") || fail "unzip $file/pins.bcf"
        xmllint --noout --schema "$schemas/version.xsd" "u-$file/bcf.version" 2>err || fail "bcf.version"
        xmllint --noout --schema "$schemas/project.xsd" "u-$file/project.bcfp" 2>err || fail "project.bcfp"
        n=0
        for topic in "u-$file"/*/; do
            xmllint --noout --schema "$schemas/markup.xsd" "$topic/markup.bcf" 2>err || fail "$topic markup.bcf"
            xmllint --noout --schema "$schemas/visinfo.xsd" "$topic/viewpoint.bcfv" 2>err || fail "$topic viewpoint.bcfv"
            n=$((n + 1))
        done
        [ $n = 2 ] || fail "$n topics in $file/pins.bcf"
    done
    mkdir u-later && (cd u-later && unzip -q ../later/pins.bcf) || fail "unzip later/pins.bcf"
    xmllint --noout --schema "$schemas/markup.xsd" u-later/*/markup.bcf 2>err || fail "markup.bcf of a pin without a view"
fi
kill $daemon && wait $daemon || fail "the daemon's end"
daemon=
no_reports
echo "room_cli${only:+ $only}: fine"
