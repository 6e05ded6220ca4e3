#!/bin/bash
# SPDX-License-Identifier: MIT
# Models of deploy/gallery are closed and have their media; its sheet puts pictures side by side.
#   gallery.sh PATH/TO/prt DEPLOY_FOLDER
set -euo pipefail
prt=${1:?the prt program}
deploy=${2:?the deploy folder}
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
for model in candle plastics; do
    python3 "$deploy/gallery_models.py" $model "$dir/$model.glb"
    "$prt" info "$dir/$model.glb" >"$dir/info"
    grep -q 'boundary_edges: 0' "$dir/info" && grep -q 'nonmanifold_edges: 0' "$dir/info" ||
        { echo "FAIL: $model is not closed"; exit 1; }
done
[ "$("$prt" material "$dir/plastics.glb" | grep -c sigma_s_prime)" = 3 ] ||
    { echo "FAIL: the plastics have not three media"; exit 1; }
"$prt" material "$dir/plastics.glb" --json |
    python3 -c 'import json, sys; assert sum("sigma_s_prime" in m["material"] for m in json.load(sys.stdin)) == 3' ||
    { echo "FAIL: the plastics have not three media in JSON"; exit 1; }
name=$("$prt" material "$dir/plastics.glb" | sed -n '2s/ (glTF).*//p')
[ "$("$prt" material "$dir/plastics.glb#$name" | sed 's/ (glTF).*//')" = "$name" ] ||
    { echo "FAIL: #$name lists other media"; exit 1; }
"$prt" env constant:0.5,0.1,0.2 --layout latlong --size 64x32 --tone none -q -o "$dir/a.png"
python3 "$deploy/gallery_sheet.py" 2 "$dir/a.png" "$dir/a.png" "$dir/a.png" "$dir/a.png" "$dir/sheet.png"
"$prt" env "$dir/sheet.png" --layout latlong --size 128x64 --tone none -q -o "$dir/b.png"
python3 - "$dir" "$deploy" <<'END'
import sys
sys.path.insert(0, sys.argv[2])
from gallery_sheet import read
one, sheet = read(sys.argv[1] + "/a.png"), read(sys.argv[1] + "/b.png")
assert sheet[:2] == (128, 64) and sheet[2] == [row + row for row in one[2]] * 2, "the sheet is wrong"
END
