#!/bin/bash
# SPDX-License-Identifier: MIT
# relightd --runner slurm beside a Slurm of its own (deploy/cluster/with_slurm): an array of four tasks
# makes the bytes of a local bake, also where Slurm runs a task again and where relightd restarts
# meanwhile; a task that a node cannot start is released, or its array runs again; a bake is cancelled;
# errors are told in prt's words. With `time`: an array whose time was too short runs again with more,
# also where relightd restarts meanwhile, and keeps what was finished.
#   slurm.sh FOLDER_OF_THE_PROGRAMS [time]
set -u
bin=$1
T=$(mktemp -d /tmp/relight-slurm-test-XXXXXX)
daemon=
trap '[ -z "$daemon" ] || kill "$daemon" 2>/dev/null; wait; rm -rf "$T"' EXIT
cd "$T" || exit 1
python3 - <<'PY'
from math import cos, pi, sin
with open("ball.obj", "w") as f:
    for i in range(1, 12):
        for k in range(24):
            t, p = pi * i / 12, 2 * pi * k / 24
            f.write("v %.9g %.9g %.9g\n" % (sin(t) * cos(p), cos(t), sin(t) * sin(p)))
    f.write("v 0 1 0\nv 0 -1 0\n")
    at = lambda i, k: 24 * i + k % 24 + 1
    for i in range(10):
        for k in range(24):
            f.write("f %d %d %d\nf %d %d %d\n" % (at(i, k), at(i, k + 1), at(i + 1, k),
                                                at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)))
    for k in range(24):
        f.write("f 265 %d %d\nf 266 %d %d\n" % (at(0, k + 1), at(0, k), at(10, k), at(10, k + 1)))
PY
start() { # NAME OPTION…
    local name=$1
    shift
    "$bin/relightd" --data "$T/$name" --listen "unix:$T/$name.s" "$@" 2>>"$T/$name.log" &
    daemon=$!
    for _ in $(seq 1200); do [ -S "$T/$name.s" ] && break; sleep .05; done
    export RELIGHT_SERVER=unix:$T/$name.s
}
stop() { kill "$daemon"; wait "$daemon"; daemon=; }
wrong() { echo "WRONG: $*"; tail -n 20 "$T"/*.log; exit 1; }
load() { "$bin/relight" load ball.obj --size-mm 10 --material marble --transport wavelet --samples "$1" --cube 16 "${@:2}"; }
id_of() { sed -n 's/^\([0-9a-f]\{32\}\).*/\1/p' | head -1; }
ready() { # ID SECONDS
    local _
    for _ in $(seq $(($2 * 5))); do
        "$bin/relight" info "$1" 2>/dev/null | grep -q 'state: ready' && return 0
        "$bin/relight" info "$1" 2>/dev/null | grep -q 'state: failed' && return 1
        sleep .2
    done
    return 1
}

array_of() { # ID BEFORE: the number of its array, another than BEFORE
    local array= _
    for _ in $(seq 3000); do
        read -r array _ 2>/dev/null <"nodes/$1/.slurm/array"
        [ -n "$array" ] && [ "$array" != "$2" ] && break
        sleep .1
    done
    echo "$array"
}
limit_of() { squeue -h -r -t all -j "$1" -o %l | sort -u; }

slurm=(--runner slurm --slurm-tasks 4 --slurm-folder "$T/nodes" --bake-threads 1)
mkdir nodes
if [ "${2-}" = time ]; then
    start slurm "${slurm[@]}"
    id=$(load 12000 | id_of)
    first=$(array_of "$id" "")
    # Task 0 stops half-way, and the administrator leaves it one minute.
    task="$T/nodes/$id/.slurm/out.prt"
    for _ in $(seq 1200); do stuck=$(pgrep -f "^[^ ]*prt bake .*--shard=0/4 .* $task\$") && break; sleep .05; done
    kill -STOP $stuck || wrong "no task 0"
    before=$(limit_of "$first")
    scontrol update JobId="$first" TimeLimit=1 || wrong "no shorter time"
    done=(nodes/"$id"/.slurm/done.{1,2,3})
    for _ in $(seq 2400); do [ -e "${done[0]}" ] && [ -e "${done[1]}" ] && [ -e "${done[2]}" ] && break; sleep .1; done
    ln "$task".[123]-of-4.part . || wrong "no finished parts: $(ls -la "nodes/$id/.slurm")"
    stat -c '%i %y' out.prt.?-of-4.part >parts
    second=$(array_of "$id" "$first")
    [ "$second" != "$first" ] || wrong "the array does not run again: $(squeue -t all)"
    grep -q "Slurm job $first took longer than ${before%%:*} min; it runs again" slurm.log || wrong "it is not told"
    [ "$(limit_of "$second")" = "$((4 * ${before%%:*})):00" ] || wrong "its limit: $(limit_of "$second") after $before"
    kill -9 "$daemon"
    wait "$daemon" 2>/dev/null
    start slurm "${slurm[@]}"
    squeue -h -t PD,R -j "$second" | grep -q . || wrong "the second array has ended before it was seen"
    stat -c '%i %y' "$task".[123]-of-4.part | cmp - parts || wrong "finished parts are made again"
    ready "$id" 200 || wrong "the bake that ran again"
    "$bin/prt" bake ball.obj --size-mm 10 --material marble --transport wavelet --samples 12000 --cube 16 -q -o own.prt
    cmp own.prt "slurm/bakes/$id.prt" || wrong "other bytes"
    grep -q "Slurm job $second is followed again" slurm.log || wrong "the second array was not followed"
    stop
    echo "a task beyond its time: array $first of $before, then $second of $((4 * ${before%%:*})) min"
    exit 0
fi

start local --bake-threads 1
id=$(load 4000 | id_of)
ready "$id" 60 || wrong "the local bake"
stop

start slurm "${slurm[@]}"
[ "$(load 4000 | id_of)" = "$id" ] || wrong "another id"
ready "$id" 90 || wrong "the bake on Slurm"
cmp "local/bakes/$id.prt" "slurm/bakes/$id.prt" || wrong "other bytes"
[ -z "$(ls nodes)" ] || wrong "files are left for the nodes: $(ls nodes)"
echo "an array of 4 made the bytes of the local bake"

# A task that Slurm runs again, and a relightd that is killed: the same array goes on.
id2=$(load 12000 | id_of)
for _ in $(seq 600); do [ -n "$(squeue -h -t R -r)" ] && break; sleep .1; done
read -r array _ <"nodes/$id2/.slurm/array"
# Its time follows from the estimate, not from the partition, and what is to go is told.
limit=$(squeue -h -r -j "$array" -o %l | sort -u)
case $limit in [1-9]:00) ;; *) wrong "--time is $limit, of a partition of 1:00:00" ;; esac
"$bin/prt" bake ball.obj --size-mm 10 --material marble --transport wavelet --samples 12000 --cube 16 --estimate -o x |
    grep -qE '^[0-9]+ [0-9]+ [0-9]+$' || wrong "the estimate"
grep -qE "Slurm job $array: 4 tasks of about [0-9]+ s, at most ${limit%%:*} min" slurm.log || wrong "the estimate is not told"
echo "a task of the array has $limit"
scontrol requeue "${array}_0" || wrong "task 0 could not be requeued"
kill -9 "$daemon"
wait "$daemon" 2>/dev/null
start slurm "${slurm[@]}"
ready "$id2" 120 || wrong "the bake after a restart"
grep -q "is followed again" slurm.log || wrong "the array was not followed again"
stop
start local --bake-threads 1
[ "$(load 12000 | id_of)" = "$id2" ] && ready "$id2" 60 || wrong "the second local bake"
cmp "local/bakes/$id2.prt" "slurm/bakes/$id2.prt" || wrong "other bytes after a requeue and a restart"
stop
echo "a requeued task and a killed relightd: the same bytes"

# By itself: progress with the seconds to go, at first the estimate.
args=(bake ball.obj --size-mm 10 --material marble --transport wavelet --samples 400 --cube 16 --no-single)
"$bin/relight-slurm" --tasks=2 -- "${args[@]}" --threads=1 -o "$T/direct.prt" --progress-fd 3 3>progress 2>out ||
    wrong "relight-slurm: $(cat out)"
"$bin/prt" "${args[@]}" -q -o "$T/own.prt" || wrong "prt bake"
cmp direct.prt own.prt || wrong "other bytes of relight-slurm"
task=$(sed -n 's/.* tasks of about \([0-9]*\) s.*/\1/p' out)
awk -v task="$task" 'NF != 3 || $3 < 0 || $3 > task + 1 {exit 1} NR == 1 && $3 < task / 2 {exit 1}' progress ||
    wrong "no time to go, of $task s: $(cat progress)"

# A small bake is not worth several tasks.
start few --runner slurm --slurm-folder "$T/nodes" --bake-threads 1
id5=$(load 300 | id_of)
ready "$id5" 90 || wrong "the small bake"
grep -q ": 1 tasks of about" few.log || wrong "a small bake has several tasks"
stop

# A node that cannot start a task, for a file of a run before lies in its way: Slurm holds the task. It is
# released, or the array runs again where that is not allowed. There the first scancel comes too early, as
# it does before a start that fails: the task must not stay in the queue.
lies_in_the_way() { # sets next, the first of the jobs that cannot start
    local d i n
    next=$(scontrol show config | sed -n 's/^NEXT_JOB_ID *= *//p')
    for n in n1 n2; do
        for i in 0 1; do
            d=$(printf '%s/d/%s/job%05d' "$(dirname "$SLURM_CONF")" $n $((next + i)))
            mkdir -p "$d" && echo >"$d/slurm_script"
        done
    done
}
mkdir not_allowed
printf '#!/bin/sh\necho "Access/permission denied" >&2\nexit 1\n' >not_allowed/scontrol
cat >not_allowed/scancel <<SH
#!/bin/sh
[ -e $T/cancelled ] || { : >$T/cancelled; exit 0; }
exec $(command -v scancel) "\$@"
SH
chmod +x not_allowed/scontrol not_allowed/scancel
for way in "$PATH" "$T/not_allowed:$PATH"; do
    lies_in_the_way
    PATH=$way "$bin/relight-slurm" --tasks=2 -- "${args[@]}" --threads=1 -o "$T/held.prt" 2>out ||
        wrong "a held task: $(cat out)"
    cmp held.prt own.prt || wrong "other bytes after a held task"
    rm held.prt
    grep -qE "a node failed to start task [01] of Slurm job $next; it was released|job $next could not be started" out ||
        wrong "it was not held: $(cat out)"
done
grep -q "Slurm job $next could not be started on a node; it runs again" out || wrong "it was released: $(cat out)"
[ -e cancelled ] || wrong "nothing was cancelled"
for _ in $(seq 200); do [ -z "$(squeue -h -t PD,R)" ] && break; sleep .1; done
[ -z "$(squeue -h -t PD,R)" ] || wrong "a task stays in the queue: $(squeue)"
echo "a task that a node could not start was released, or its array ran again, and nothing stays in the queue"

start slurm "${slurm[@]}"
job=$(load 60000 --seed 5 | sed -n 's/.*job \(job-[0-9a-f-]*\).*/\1/p')
for _ in $(seq 600); do [ -n "$(squeue -h -t R -r)" ] && break; sleep .1; done
"$bin/relight" cancel "$job" >/dev/null || wrong "cancel"
for _ in $(seq 600); do [ -z "$(squeue -h -t PD,R)" ] && break; sleep .1; done
[ -z "$(squeue -h -t PD,R)" ] || wrong "Slurm goes on after a cancel: $(squeue)"
echo "a bake was cancelled"

echo "v 0 0 0" >broken.obj
"$bin/relight" load broken.obj --size-mm 10 --material marble --transport wavelet >out 2>&1
id3=$(id_of <out)
[ -z "$id3" ] || { ready "$id3" 30; "$bin/relight" info "$id3" >>out 2>&1; }
grep -qiE 'triangle|face|empty|nothing' out || wrong "no words for a broken model: $(cat out)"
"$bin/relight" load ball.obj --size-mm 10 --samples 9000000 --name big >out 2>&1
id4=$(id_of <out)
ready "$id4" 30
"$bin/relight" info "$id4" >>out 2>&1
grep -qE 'sbatch|memory|estimated to take [0-9]+ minutes' out || wrong "no words for a bake beyond the partition: $(cat out)"
echo "errors come in their own words"
stop
