#!/bin/sh
# SPDX-License-Identifier: MIT
# prt-bench: its list, its JSON lines, its refusals.
set -eu
bench=$1
fail() { echo "bench.sh: $*" >&2; exit 1; }
"$bench" --list | grep -q '^relight_factored ' || fail "--list does not name relight_factored"
names='bandwidth cold_start relight_factored relight_phase relight_sparse
    edit_joint edit_polynomial joint_frame'
out=$("$bench" --quick $names)
# A daemon of their own, on both carriers.
out="$out
$("$bench" --quick daemon_answers daemon_new_env daemon_clients serve)"
echo "$out"
[ "$(echo "$out" | wc -l)" -ge 15 ] || fail "too few figures"
if echo "$out" | grep -v '^{"bench":"[a-z0-9_]*","cpu":"[a-z0-9]*","threads":[0-9]*\(,"[A-Za-z0-9_]*":\("[^"]*"\|null\|-\{0,1\}[0-9.e+-]*\)\)*}$'; then
    fail "a line is not the JSON it should be"
fi
echo "$out" | grep -q '"factored_million_8_lights".*"times_one":[0-9]' || fail "no ratio of 8 lights"
for figure in daemon_image_jpeg_new_angle daemon_image_png_unused_light daemon_colors_f16 \
    daemon_new_hdr_to_picture daemon_new_exr_to_picture daemon_new_png_to_picture; do
    echo "$out" | grep -q "\"$figure\".*\"ms_p95\":[0-9]" || fail "no $figure"
done
echo "$out" | grep -q '"daemon_clients.*"clients":8,.*"images_per_s":[0-9]' || fail "no 8 clients"
for figure in serve_small_requests serve_idle_connections serve_lights_rgb9e5 serve_same_light_rgb9e5 \
    serve_pictures_jpeg serve_overload serve_overload_memory serve_greedy serve_zipf; do
    echo "$out" | grep "\"$figure\"" | grep -q '"goal":"\(met\|missed\)"' || fail "no $figure"
done
# Walks in a closed body: a figure for each of three media.
model=$(mktemp /tmp/bench-XXXXXX.obj)
trap 'rm -f "$model"' EXIT
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n' > "$model"
walks=$("$bench" --quick --model "$model" walk)
[ "$(echo "$walks" | grep -c '"medium".*"ratio_to_bare":[0-9].*"rays_spared":0\.[0-9].*"lost":[0-9]')" = 3 ] ||
    fail "walk prints $walks"
# Of a finer model: tensors of one material are measured, those whose material is free are not.
baked=$model.prt
trap 'rm -f "$model" "$baked"' EXIT
for of in '--material marble:[1-9]' '--transport joint:0'; do
    # shellcheck disable=SC2086 # words
    "${bench%-bench}" bake "$model" --size-mm 20 ${of%:*} --samples 200 --cube 16 --single-points 2 --quiet -o "$baked" ||
        fail "bake ${of%:*}"
    finer=$("$bench" --quick --file "$baked" relight_million) || fail "relight_million of ${of%:*} fails"
    echo "$finer" | grep -c '"million_tensor_[0-9]*".*"vertices":100000,' | grep -qx "${of#*:}" ||
        fail "relight_million of ${of%:*} prints $finer"
done
# Of a file first multiple scattering alone, then all of it: more functions, and a goal of its own.
edits=$("$bench" --quick --file "$baked" edit_file joint_file) || fail "edit_file or joint_file fails"
functions_of() { echo "$edits" | sed -n "s/.*\"$1\".*\"functions\":\([0-9]*\),.*\"target_$2\":$3[,}].*/\1/p"; }
for figure in 'edit_file Mvertices_per_s 120 30' 'joint_file frames_per_s 300 100'; do
    # shellcheck disable=SC2086 # words
    set -- $figure
    multiple=$(functions_of "$1_multiple" "$2" "$3") all=$(functions_of "$1_with_single" "$2" "$4")
    [ "${multiple:-0}" -gt 0 ] && [ "${all:-0}" -gt "$multiple" ] || fail "$1 prints $edits"
done
code=0; "$bench" no_such_figure 2>/dev/null || code=$?
[ $code = 2 ] || fail "an unknown name exits $code"
code=0; "$bench" --file /nowhere.prt relight_file 2>/dev/null || code=$?
[ $code = 1 ] || fail "a missing file exits $code"
code=0; "$bench" --cpu mmx 2>/dev/null || code=$?
[ $code = 2 ] || fail "an unknown --cpu exits $code"
