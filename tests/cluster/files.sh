#!/bin/bash
# SPDX-License-Identifier: MIT
# The files of deploy/cluster: what programs that are here can say of them. Each check that a missing
# program prevents is named; where none could be made the test is skipped.
#   files.sh FOLDER BUILD_FOLDER
set -u
cd "$1" || exit 1
build=$2
made=0 bad=0
check() { # PROGRAM NAME COMMAND…
    local program=$1 name=$2 out
    shift 2
    command -v "$program" >/dev/null || { echo "skipped: $name: no $program (deploy/dependencies --cluster)"; return; }
    made=$((made + 1))
    if out=$("$@" 2>&1); then echo "fine: $name${out:+ ($(echo "$out" | tail -1))}"; else echo "WRONG: $name"; echo "$out" | tail -20; bad=$((bad + 1)); fi
}
for script in try with_postgres with_slurm relight-slurm image; do check bash "$script" bash -n "$script"; done
check promtool alerts.yml promtool check rules alerts.yml
check promtool alerts_test.yml promtool test rules alerts_test.yml
proxy() {
    env RELIGHT_FRONT=127.0.0.1 RELIGHT_HTTP_PORT=18001 RELIGHT_TCP_PORT=18002 RELIGHT_SOURCE=0.0.0.0 \
        RELIGHT_PROXY_SOCKET=/tmp/relight-none RELIGHT_1=127.0.0.1:1 RELIGHT_2=127.0.0.1:2 RELIGHT_1_TCP=127.0.0.1:3 \
        RELIGHT_2_TCP=127.0.0.1:4 RELIGHT_1_PORT=1 RELIGHT_2_PORT=2 haproxy -c -f haproxy.cfg
}
check haproxy haproxy.cfg proxy
unit() { # a copy whose program is there
    local dir status
    dir=$(mktemp -d)
    sed "s|^ExecStart=[^ ]*|ExecStart=/bin/true|" relightd@.service.in >"$dir/relightd@.service"
    cp "$dir/relightd@.service" "$dir/relightd@1.service"
    systemd-analyze verify --man=no --generators=no --recursive-errors=no "$dir/relightd@1.service"
    status=$?
    rm -rf "$dir"
    return $status
}
check systemd-analyze relightd@.service unit
# Every alert has its place in the runbook; every metric that a rule or a panel names is one of relightd's.
words() {
    python3 - "$build/bin/relightd" <<'PY'
import json, re, subprocess, sys, tempfile, time, os, urllib.request, socket
text = open("README.md").read()
rules = open("alerts.yml").read()
for name in re.findall(r"alert: (\w+)", rules):
    assert "### " + name in text, "README.md says nothing of " + name
    assert "README.md#" + name.lower() in rules, "the runbook's address of " + name
board = json.load(open("dashboard.json"))
named = set(re.findall(r"relightd_\w+", rules + json.dumps(board)))
s = socket.socket(); s.bind(("127.0.0.1", 0)); port = s.getsockname()[1]; s.close()
with tempfile.TemporaryDirectory() as folder:
    daemon = subprocess.Popen([sys.argv[1], "--http", "127.0.0.1:%d" % port, "--listen", "unix:%s/s" % folder],
                              stderr=subprocess.DEVNULL)
    try:
        for _ in range(200):
            try:
                metrics = urllib.request.urlopen("http://127.0.0.1:%d/metrics" % port).read().decode()
                break
            except OSError:
                time.sleep(.05)
    finally:
        daemon.terminate()
        daemon.wait()
there = set(re.findall(r"# TYPE (\w+)", metrics))
program = open(sys.argv[1], "rb").read()  # a histogram is there from its first value on
for name in sorted(named):
    base = re.sub(r"_(bucket|count|sum)$", "", name)
    assert name in there or base in there or base != name and base.encode() in program, "no metric " + name
print(len(named), "metrics")
PY
}
check python3 "names of alerts and metrics" words
check ./simulate simulate ./simulate --users 20000 --models 1000 --replicas 2,3
reads() { # its figures are those that capacity writes
    ./simulate --users 2000 --models 100 --replicas 2 --figures figures.json | grep -q "a picture $(python3 -c '
import json; print("%.3g" % json.load(open("figures.json"))["picture_ms"])') ms"
}
check python3 "simulate --figures" reads
check /usr/bin/python3 "figures of README.md" ./capacity --page --check
shapes() {
    /usr/bin/python3 - <<'PY'
import sys
try:
    import yaml
except ImportError:
    sys.exit(0)
compose = yaml.safe_load(open("compose.yaml"))
volumes = {v.split(":")[0] for s in compose["services"].values() for v in s.get("volumes", []) if v[0] not in "./"}
assert volumes == set(compose["volumes"]), volumes ^ set(compose["volumes"])
secrets = {x for s in compose["services"].values() for x in s.get("secrets", [])}
assert secrets == set(compose["secrets"]), secrets ^ set(compose["secrets"])
kinds = {}
for o in yaml.safe_load_all(open("kubernetes/relightd.yaml")):
    kinds[o["kind"]] = o
pod = kinds["StatefulSet"]["spec"]["template"]
label = pod["metadata"]["labels"]
for kind in ("Service",):
    assert kinds[kind]["spec"]["selector"] == label
assert kinds["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"] == label
assert kinds["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"] == label
box = pod["spec"]["containers"][0]
names = {v["name"] for v in pod["spec"]["volumes"]} | {v["metadata"]["name"]
                                                       for v in kinds["StatefulSet"]["spec"]["volumeClaimTemplates"]}
assert {m["name"] for m in box["volumeMounts"]} == names
drain = sum(float(box["args"][box["args"].index(w) + 1]) for w in ("--lame-duck", "--drain"))
assert drain + 3 <= pod["spec"]["terminationGracePeriodSeconds"], "the pod is killed before it has drained"
try:
    from kubernetes import client
except ImportError:
    print("skipped: kubernetes/relightd.yaml against the API's models: no python3-kubernetes")
    sys.exit(0)
import json, re
class Answer:
    def __init__(self, o):
        self.data = json.dumps(o)
def model(name):
    return getattr(client, name, None) or getattr(client, name.replace("V2", "V2beta2"))  # before 1.23
def known(o, kind, path):  # every field is one of the API's; what it wants, its constructor asks for
    item = re.match(r"list\[(.*)\]$|dict\(str, (.*)\)$", kind)
    if item:
        values = o.items() if isinstance(o, dict) else enumerate(o)
        for key, value in values:
            known(value, item.group(1) or item.group(2), "%s.%s" % (path, key))
    elif hasattr(client, kind):
        there = model(kind)
        fields = {name: field for field, name in there.attribute_map.items()}
        for name, value in o.items():
            assert name in fields, "%s.%s is no field of %s" % (path, name, kind)
            known(value, there.openapi_types[fields[name]], "%s.%s" % (path, name))
    else:
        want = {"str": str, "int": int, "bool": bool, "float": (int, float)}.get(kind, object)
        assert isinstance(o, want), "%s: %r is no %s" % (path, o, kind)
for kind, o in kinds.items():
    name = model(("V2" if o["apiVersion"].endswith("v2") else "V1") + kind).__name__
    client.ApiClient().deserialize(Answer(o), name)
    known(o, name, kind)
for kind, path, wrong in (("Service", "spec", {"port": []}), ("Service", "spec", {"ports": [{"port": "x"}]})):
    try:  # a manifest with a fault is refused
        known(wrong, "V1ServiceSpec", path)
    except AssertionError:
        continue
    raise SystemExit("a fault in a manifest is not seen")
print("kubernetes: fields of", ", ".join(kinds))
PY
}
check /usr/bin/python3 "compose.yaml and kubernetes" shapes
options() { # every option that these files name is one of relightd's
    local word
    for word in $(grep -ohE -- '--[a-z][a-z-]+' compose.yaml kubernetes/relightd.yaml Containerfile | sort -u); do
        case $word in --from | --preset | --build | --target | --mount | --secret | --stage | --images | --format | --build-arg | --page | --interval | --timeout | --start-period) continue ;; esac
        "$build/bin/relightd" --help | grep -q -- "$word" || { echo "relightd has no $word"; return 1; }
    done
}
check "$build/bin/relightd" "options of relightd" options
[ $made -gt 0 ] || exit 77
exit $((bad > 0))
