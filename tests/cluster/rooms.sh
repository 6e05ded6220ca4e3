#!/bin/bash
# SPDX-License-Identifier: MIT
# Two relightd on one PostgreSQL (deploy/cluster/with_postgres): a token that one made is the other's, and is
# refused there within a second of its revocation; both revoke at once; who is invited at one may enter at the
# other; rooms go from SQLite to PostgreSQL and back, event by event.
#   rooms.sh FOLDER_OF_THE_PROGRAMS
set -u
export USER=ann
bin=$1
T=$(mktemp -d /tmp/relight-rooms-XXXXXX)
pids=()
trap 'for p in "${pids[@]}"; do kill "$p" 2>/dev/null; done; wait; rm -rf "$T"' EXIT
cd "$T" || exit 1
wrong() { echo "WRONG: $*"; tail -n 12 "$T"/*.log "$T/out" 2>/dev/null; exit 1; }
start() { # NAME OPTION…
    "$bin/relightd" --data "$T/$1" --listen "unix:$T/$1.s" --listen tcp:127.0.0.1:0 "${@:2}" 2>>"$T/$1.log" &
    pids+=($!)
    for _ in $(seq 1200); do grep -q ' start version' "$T/$1.log" 2>/dev/null && return; sleep .05; done
    wrong "$1 does not start"
}
stop() { kill "${pids[-1]}"; wait "${pids[-1]}"; unset 'pids[-1]'; }
tcp() { sed -n 's/.*address=tcp:\(127.0.0.1:[0-9]*\).*/tcp:\1/p' "$T/$1.log" | tail -1; }
ask() { timeout 30 "$bin/relight" -s "$@" >out 2>&1 </dev/null; }
until_true() { # SECONDS COMMAND…
    local end=$((SECONDS + $1))
    shift
    while ! "$@"; do [ $SECONDS -lt $end ] || return 1; sleep .05; done
}

# ---- rooms from SQLite, before there was a database
start one
printf 'v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n' >ball.obj
printf 'f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n' >>ball.obj
ask "unix:$T/one.s" load ball.obj --size-mm 20 --material marble --preview || wrong load
ask "unix:$T/one.s" room create first --model ball --env constant --size 64x48 || wrong create
room=$(grep -oE '[0-9a-f]{32}' out | head -1)
ask "unix:$T/one.s" room pin "$room" "too red" --at 0,2,0.3,0.2 || wrong pin
for i in 1 2 3; do ask "unix:$T/one.s" room reply "$room" 2 "reply $i" || wrong reply; done
ask "unix:$T/one.s" room create second --model ball --env constant || wrong create
ask "unix:$T/one.s" room show "$room" --json || wrong show
cp out before
ask "unix:$T/one.s" room list --json || wrong "room list"
cp out list
stop
rooms=$RELIGHT_TEST_POSTGRES
"$bin/relightd" --copy-rooms sqlite:one/rooms.sqlite --rooms "$rooms" >out 2>&1 || wrong "copy to PostgreSQL"
grep -q "2 rooms are the same" out || wrong "the copy's account"
"$bin/relightd" --copy-rooms sqlite:one/rooms.sqlite --rooms "$rooms" >out 2>&1 || wrong "the same copy once more"
grep -q " 0 events were copied" out || wrong "a copy that is there is made again"
"$bin/relightd" --copy-rooms "$rooms" --rooms sqlite:back.sqlite >out 2>&1 || wrong "copy back"
"$bin/relightd" --copy-rooms nothing:here --rooms sqlite:back.sqlite >out 2>&1 && wrong "a store of no kind"

# ---- the same room by either replica, and from the copy
start a --rooms "$rooms" --store "$T/shared"
start b --rooms "$rooms" --store "$T/shared"
for r in a b; do
    ask "unix:$T/$r.s" room show "$room" --json || wrong "show by $r"
    cmp -s out before || wrong "another room by $r"
    ask "unix:$T/$r.s" room list --json || wrong "room list by $r"
    cmp -s out list || wrong "another list of rooms by $r"
done
start c --rooms sqlite:back.sqlite
ask "unix:$T/c.s" room show "$room" --json && cmp -s out before || wrong "another room after the way back"
ask "unix:$T/c.s" room list --json && cmp -s out list || wrong "another list of rooms after the way back"
stop
echo "rooms went to PostgreSQL and back"

# ---- tokens
ask "unix:$T/a.s" token create --name ann --scope view,edit,upload || wrong "token create"
token=$(grep -oE 'relight_[A-Za-z0-9_-]+' out | head -1)
until_true 3 ask "$(tcp b)" models -k "$token" || wrong "b does not know the token"
ask "$(tcp b)" models && wrong "b takes clients without a token"
ask "$(tcp b)" models -k "${token}x" && wrong "b takes any token"
ask "unix:$T/b.s" token list && grep -q ann out || wrong "b's list of tokens"
"$bin/relight" -s "$(tcp b)" -k "$token" events --follow >events.out 2>&1 </dev/null &
pids+=($!)
open=$!
until_true 10 eval 'ask "unix:$T/b.s" token list --json && grep -q "\"connections\":1" out' ||
    wrong "b counts no connection of the token"
ask "unix:$T/a.s" token revoke ann || wrong "token revoke"
begin=$(date +%s%N)
until_true 3 eval '! ask "$(tcp b)" models -k "$token"' || wrong "b takes a revoked token"
ms=$((($(date +%s%N) - begin) / 1000000))
[ $ms -lt 1000 ] || wrong "b refused the revoked token after $ms ms"
until_true 5 eval '! kill -0 $open 2>/dev/null' || wrong "b keeps a connection of the revoked token"
echo "a token of one replica is the other's; revoked, it is refused there after $ms ms"

for i in 1 2 3 4 5 6; do ask "unix:$T/a.s" token create --name "t$i" --scope view || wrong "token create t$i"; done
until_true 3 eval 'ask "unix:$T/b.s" token list && grep -q t6 out' || wrong "b does not know t6"
revokers=()
for i in 1 2 3 4 5 6; do
    "$bin/relight" -s "unix:$T/$([ $((i % 2)) = 0 ] && echo a || echo b).s" token revoke "t$i" >"t$i.out" 2>&1 &
    revokers+=($!)
done
for i in "${!revokers[@]}"; do wait "${revokers[i]}" || wrong "revoke t$((i + 1)): $(cat "t$((i + 1)).out")"; done
for r in a b; do
    until_true 3 eval 'ask "unix:$T/$r.s" token list && ! grep -q "t[1-6] " out' || wrong "$r has a revoked token"
done
echo "both replicas revoke at once"
for r in a b; do # of the list in the database
    until_true 3 test -e "$r/tokens.json" || wrong "$r has no copy of the tokens"
    [ "$(stat -c %a "$r/tokens.json")" = 600 ] || wrong "others may read the tokens: $(stat -c %a "$r/tokens.json")"
done

# ---- invitations
ask "unix:$T/a.s" room invite "$room" guest --role viewer || ask "unix:$T/a.s" room invite "$room" || wrong "invite"
secret=$(grep -oE 'relight_guest_[A-Za-z0-9_-]+|relight_[A-Za-z0-9_-]{30,}' out | head -1)
[ -n "$secret" ] || wrong "no secret of a guest"
until_true 3 ask "$(tcp b)" room show "$room" -k "$secret" || wrong "the guest of a may not enter by b"
echo "a guest of one replica enters by the other"

# ---- who may not be in a room any more leaves it at the other replica, too
watch() { # NAME REPLICA OPTION…
    "$bin/relight" -s "$2" room watch "$room" "${@:3}" >"$1.out" 2>&1 </dev/null &
    pids+=($!)
    watching[$1]=$!
}
sees() { ask "unix:$T/a.s" room reply "$room" 2 "are you there?"; [ -s "$1.out" ]; }
left() { ! kill -0 "${watching[$1]}" 2>/dev/null; }
declare -A watching
ask "unix:$T/a.s" token create --name eve --scope view || wrong "token create"
eve=$(grep -oE 'relight_[A-Za-z0-9_-]+' out | head -1)
ask "unix:$T/a.s" room member "$room" token:eve --role viewer || wrong member
watch eve "$(tcp b)" -k "$eve"
watch guest "$(tcp b)" -k "$secret"
watch owner "unix:$T/b.s"
for who in eve guest owner; do until_true 10 sees $who || wrong "$who sees nothing by b"; done
ask "unix:$T/a.s" room member "$room" token:eve --role none || wrong "member none"
until_true 5 left eve || wrong "one who was removed by a stays by b"
ask "unix:$T/a.s" room show "$room" --json || wrong show
invitation=$(python3 -c 'import json
def find(x):
    for key, value in x.items():
        if key == "invites": return value[0]["id"]
        if isinstance(value, dict) and (found := find(value)): return found
print(find(json.load(open("out"))))')
ask "unix:$T/a.s" room revoke "$room" "$invitation" || wrong "revoke"
until_true 5 left guest || wrong "a guest whose invitation a revoked stays by b"
left owner && wrong "the owner left"
echo "who was removed by one replica leaves at the other"

# ---- a room that another replica deletes: no seat stays, and no count goes below what is held
ask "unix:$T/a.s" room close "$room" || wrong close
start d --rooms "$rooms" --store "$T/shared" --rooms-keep 0.001
until_true 10 grep -q "room=$room deleted=closed" d.log || wrong "d deletes nothing"
until_true 5 left owner || wrong "one sits in a room that is gone"
ask "unix:$T/b.s" room show "$room" && wrong "b shows a room that is gone"
for r in a b d; do ask "unix:$T/$r.s" room list || wrong "$r lists no rooms"; done
echo "a room that one replica deletes is gone at the others"
