#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The part of `try` between the services: replicas, the proxy, clients, faults, and the account of it.

   try.py FOLDER_OF_THE_PROGRAMS FOLDER_OF_HAPROXY_CFG      under with_slurm and with_postgres"""
import http.client
import json
import math
import os
import queue
import re
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time

BIN, HERE = sys.argv[1], sys.argv[2]
for package in (os.path.join(BIN, "../python"), os.path.join(BIN, "../lib/python3/dist-packages")):
    if os.path.isdir(package):
        sys.path.insert(0, package)
try:
    import relight
except ImportError as fault:
    print("skipped: the Python client is not built: %s (deploy/dependencies --cluster)" % fault)
    sys.exit(77)

FOLDER = tempfile.mkdtemp(prefix="relight-cluster-")
DATABASE = os.environ["RELIGHT_TEST_POSTGRES"]
BAKE = {"transport": "wavelet", "cube": 16, "material": "marble"}
bad = []


def free_ports(n):
    sockets = [socket.socket() for _ in range(n)]
    for s in sockets:
        s.bind(("127.0.0.1", 0))
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return ports


def say(text):
    print("%6.1f s  %s" % (time.monotonic() - BEGIN, text), flush=True)


def hold(what, good):
    """One line of the account; a line that is wrong fails the trial."""
    say(("       " if good else "WRONG  ") + what)
    if not good:
        bad.append(what)


goals = []  # (number, measured, at most, unit)


def goal(what, value, most, unit, good):
    """A number beside its goal; beyond `good` the trial fails, or with RELIGHT_TRY_GOALS=1 beyond the goal."""
    goals.append((what, value, most, unit))
    strict = os.environ.get("RELIGHT_TRY_GOALS")
    hold("%s: %.4g %s (goal %g)" % (what, value, unit, most), value <= (most if strict else good))


def table():
    print("%-62s %10s %10s" % ("number", "measured", "goal"))
    for what, value, most, unit in goals:
        print("%-62s %10.4g %10g %-3s %s" % (what, value, most, unit, "" if value <= most else "MISSED"))


def until(seconds, call):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            got = call()
            if got:
                return got
        except (relight.RelightError, OSError, ValueError):
            pass
        time.sleep(0.02)
    return None


class Replica:
    def __init__(self, number, tcp, web):
        self.number, self.tcp, self.web = number, tcp, web
        self.address = "tcp:127.0.0.1:%d" % tcp
        self.socket = "unix:%s/s%d" % (FOLDER, number)
        self.start()

    def start(self):
        log = open("%s/replica%d.log" % (FOLDER, self.number), "ab")
        self.process = subprocess.Popen(
            [BIN + "/relightd", "--data", "%s/data%d" % (FOLDER, self.number), "--store", FOLDER + "/shared",
             "--rooms", DATABASE, "--runner", "slurm", "--slurm-folder", FOLDER + "/shared/slurm",
             "--slurm-tasks", "4", "--bake-threads", "1", "--listen", self.address, "--listen", self.socket,
             "--http", "127.0.0.1:%d" % self.web, "--proxies", "127.0.0.2", "--store-poll", "0.5",
             "--lame-duck", "2", "--drain", "5"], stderr=log)
        log.close()

    def ready(self):
        return ask(self.web, "/readyz")[0] == 200

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def restart(self):
        self.process.terminate()
        status = self.process.wait(30)
        self.start()
        return status


def ask(port, path, timeout=10):
    c = http.client.HTTPConnection("127.0.0.1", port, timeout=timeout)
    try:
        c.request("GET", path)
        answer = c.getresponse()
        return answer.status, answer.read()
    finally:
        c.close()


def command(server, *words, seconds=30):
    done = subprocess.run([BIN + "/relight", "-s", server, *words], capture_output=True, timeout=seconds,
                          env=dict(os.environ, USER="ann"), check=False)
    return done.returncode, done.stdout.decode(), done.stderr.decode()


def ball(path, rings=10):
    """A ball of triangles."""
    with open(path, "w", encoding="ascii") as f:
        for i in range(1, rings):
            for k in range(2 * rings):
                t, p = math.pi * i / rings, math.pi * k / rings
                f.write("v %.9g %.9g %.9g\n" % (math.sin(t) * math.cos(p), math.cos(t), math.sin(t) * math.sin(p)))
        f.write("v 0 1 0\nv 0 -1 0\n")
        n = 2 * rings
        at = lambda i, k: n * i + k % n + 1  # noqa: E731
        for i in range(rings - 2):
            for k in range(n):
                f.write("f %d %d %d\nf %d %d %d\n" % (at(i, k), at(i, k + 1), at(i + 1, k),
                                                      at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)))
        low = n * (rings - 1)
        for k in range(n):
            f.write("f %d %d %d\nf %d %d %d\n" % (low + 1, at(0, k + 1), at(0, k),
                                                  low + 2, at(rings - 2, k), at(rings - 2, k + 1)))


# ---- clients: each a thread; they go on until `stop` is set

stop = threading.Event()


class Client(threading.Thread):
    """One client: steps one after another, connected again where the connection is lost."""

    def __init__(self, address, model):
        super().__init__(daemon=True)
        self.address, self.model = address, model
        self.steps = self.reconnects = self.failed = 0
        self.last, self.gap, self.errors = time.monotonic(), 0.0, []

    def mark(self):
        """(steps, reconnects, failed), and the longest gap begins anew."""
        self.gap = 0.0
        return self.steps, self.reconnects, self.failed

    def run(self):
        while not stop.is_set():
            try:
                with relight.Client(self.address, timeout=10) as client:
                    self.begin(client)
                    while not stop.is_set():
                        self.step(client)
                        now = time.monotonic()
                        self.gap = max(self.gap, now - self.last)
                        self.last = now
                        self.steps += 1
            except (relight.RelightError, OSError, TimeoutError) as error:
                if stop.is_set():
                    return
                code = getattr(error, "code", "DISCONNECTED")
                if code in ("DISCONNECTED", "UNREACHABLE", "SHUTTING_DOWN", "CANCELLED", "BUSY"):
                    self.reconnects += 1
                else:
                    self.failed += 1
                    self.errors.append("%s: %s" % (code, error))
                time.sleep(0.05)


class Colours(Client):
    def begin(self, client):
        self.turn = 0

    def step(self, client):
        self.turn += 7
        client.colors(self.model, "constant", rotate=self.turn % 360)
        time.sleep(0.02)


class Viewer(Client):
    def begin(self, client):
        self.view = client.view(self.model, "constant")
        self.turn = 0

    def step(self, client):
        self.turn += 5
        self.view.set(rotate=self.turn % 360)
        self.view.next(timeout=10)
        time.sleep(0.03)


class Pictures(threading.Thread):
    """A browser's pictures through the proxy: every one has to come."""

    def __init__(self, port, model):
        super().__init__(daemon=True)
        self.port, self.model = port, model
        self.steps, self.failed, self.errors = 0, 0, []

    def run(self):
        while not stop.is_set():
            try:
                status, _ = ask(self.port, "/v1/models/%s/image.png?env=constant&size=64x48" % self.model)
            except OSError as error:
                status = str(error)
            self.steps += 1
            if status != 200:
                self.failed += 1
                self.errors.append(str(status))
            time.sleep(0.05)


class Writer(threading.Thread):
    """Edits of a room, one after another; remembers those that were acknowledged."""

    def __init__(self, server, room):
        super().__init__(daemon=True)
        self.server, self.room = server, room
        self.acknowledged, self.refused, self.times = [], 0, []

    def run(self):
        number = 0
        while not stop.is_set():
            text = "reply %d" % number
            code, _, _ = command(self.server, "room", "reply", self.room, self.pin, text)
            if code == 0:
                self.acknowledged.append(text)
                self.times.append(time.monotonic())
                number += 1
            else:
                self.refused += 1
            time.sleep(0.05)


def room_state(server, room):
    code, out, err = command(server, "room", "show", room, "--json")
    return json.loads(out) if code == 0 else None


# ---- the trial

def overhead(proxy, direct):
    """Median milliseconds of a GET through the proxy and without it, on one connection each."""
    medians = []
    for port in (proxy, direct):
        c = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        times = []
        for _ in range(400):
            t = time.perf_counter()
            c.request("GET", "/healthz")
            c.getresponse().read()
            times.append((time.perf_counter() - t) * 1e3)
        medians.append(statistics.median(times))
        c.close()
    return medians


def crossings(replicas, room):
    """The slowest of eight pins from the call of `relight room pin` at one replica to its line in `relight room watch`
    at the other, in milliseconds, the start of the first program included."""
    slowest = 0.0
    for a, b in (replicas, replicas[::-1]):
        watch = subprocess.Popen([BIN + "/relight", "-s", b.socket, "room", "watch", room, "--json"], text=True,
                                 stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=dict(os.environ, USER="bob"))
        try:
            come = queue.Queue()
            reader = threading.Thread(target=lambda w=watch, q=come: [q.put((time.monotonic(), l)) for l in w.stdout],
                                      daemon=True)
            reader.start()
            for i in range(5):
                text = "from %d, number %d" % (a.number, i)
                t = time.monotonic()
                command(a.address, "room", "pin", room, text, "--at", "0,2,0.3,0.2")
                line, end = "", t + 30
                while text not in line and time.monotonic() < end:
                    try:
                        at, line = come.get(timeout=1)
                    except queue.Empty:
                        at = time.monotonic()
                if i:  # the first comes while the watch still begins
                    slowest = max(slowest, (at - t) * 1e3)
        finally:
            watch.kill()
            watch.wait()
    return slowest


def same_bytes(front):
    """Bytes in which an array of four tasks differs from a bake on this machine alone."""
    with relight.Client(front) as c:
        model = c.load(FOLDER + "/ball.obj", size_mm=11, name="four", samples=2000, **BAKE)
    own = FOLDER + "/own.prt"
    subprocess.run([BIN + "/prt", "bake", FOLDER + "/ball.obj", "--size-mm", "11", "--material", BAKE["material"],
                    "--transport", BAKE["transport"], "--cube", str(BAKE["cube"]), "--samples", "2000", "-q", "-o", own],
                   check=True)
    with open(own, "rb") as f, open("%s/shared/bakes/%s/%s.prt" % (FOLDER, model[:2], model), "rb") as g:
        one, other = f.read(), g.read()
    return abs(len(one) - len(other)) + sum(x != y for x, y in zip(one, other))


def lines_of(number):
    """The lines of the replicas' logs about a request."""
    lines = []
    for k in (1, 2):
        with open("%s/replica%d.log" % (FOLDER, k), encoding="utf-8") as f:
            lines += [line for line in f if "request=%s " % number in line]
    return lines


def traced(port):
    """Follows the ids that the proxy gives a LOAD, whose bake's lines have it, and a request that is refused."""
    c = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    with open(FOLDER + "/ball.obj", "rb") as f:
        c.request("POST", "/v1/models?name=traced&size_mm=9&samples=300&cube=16&single_points=2", f.read())
    answer = c.getresponse()
    number, model = answer.getheader("x-request-id"), json.loads(answer.read())["model"]
    c.request("GET", "/v1/models/nope")
    answer = c.getresponse()
    refused, said = answer.getheader("x-request-id"), json.loads(answer.read())["request_id"]
    c.close()
    until(60, lambda: json.loads(ask(port, "/v1/models/%s" % model)[1])["state"] == "ready")
    hold("the id that the proxy gave a LOAD, %s, is in its bake's lines" % number,
         any("job id=" in line for line in lines_of(number)))
    hold("the id of a refused request is in its answer and in the replica's line",
         refused == said and any("refused" in line for line in lines_of(refused)))


def account(clients, marks, what):
    """What each client saw since its mark."""
    worst = 0.0
    for c, (steps, reconnects, failed) in zip(clients, marks):
        worst = max(worst, c.gap)
        say("       %-8s %4d answers, %d connected again, %d failed, longest gap %.2f s"
            % (type(c).__name__.lower(), c.steps - steps, c.reconnects - reconnects, c.failed - failed, c.gap))
    hold("%s: no request failed" % what, all(c.failed == m[2] for c, m in zip(clients, marks)))
    return worst


def main():
    os.makedirs(FOLDER + "/shared/slurm")
    ports = free_ports(6)
    web, tcp = ports[4], ports[5]
    replicas = [Replica(1, ports[0], ports[1]), Replica(2, ports[2], ports[3])]
    env = dict(os.environ, RELIGHT_FRONT="127.0.0.1", RELIGHT_HTTP_PORT=str(web), RELIGHT_TCP_PORT=str(tcp),
               RELIGHT_SOURCE="127.0.0.2", RELIGHT_PROXY_SOCKET=FOLDER + "/haproxy.sock",
               RELIGHT_1="127.0.0.1:%d" % ports[1], RELIGHT_2="127.0.0.1:%d" % ports[3],
               RELIGHT_1_TCP="127.0.0.1:%d" % ports[0], RELIGHT_2_TCP="127.0.0.1:%d" % ports[2],
               RELIGHT_1_PORT=str(ports[1]), RELIGHT_2_PORT=str(ports[3]))
    with open(FOLDER + "/haproxy.log", "wb") as log:
        proxy = subprocess.Popen(["haproxy", "-db", "-f", HERE + "/haproxy.cfg"], env=env, stderr=log, stdout=log)
    front = "tcp:127.0.0.1:%d" % tcp
    clients, pictures, writer = [], None, None
    try:
        hold("two replicas are ready behind HAProxy, PostgreSQL and Slurm run",
             bool(until(30, lambda: all(r.ready() for r in replicas) and ask(web, "/readyz")[0] == 200)))
        through, direct = overhead(web, ports[1])
        say("       a GET takes %.2f ms through the proxy, %.2f ms without (median)" % (through, direct))
        goal("the proxy adds to a request, median", through - direct, 0.3, "ms", 100)

        ball(FOLDER + "/ball.obj")
        with relight.Client(front) as c:
            model = c.load(FOLDER + "/ball.obj", size_mm=10, name="ball", samples=3000, **BAKE)
        hold("a model was loaded through the proxy, and baked by four tasks of Slurm", True)
        goal("an array of four tasks: bytes that differ from a local bake", same_bytes(front), 0, "", 0)
        for r in replicas:
            with relight.Client(r.socket) as c:
                c.colors(model, "constant")
        hold("either replica answers for it", True)

        traced(web)

        code, out, err = command(front, "room", "create", "review", "--model", model, "--env", "constant",
                                 "--size", "96x64")
        room = re.search(r"[0-9a-f]{32}", out)
        hold("a review room in PostgreSQL", room is not None)
        room = room.group(0)
        goal("a pin crosses to the other replica, slowest of eight", crossings(replicas, room), 300, "ms", 30000)

        writer = Writer(front, room)
        writer.pin = "2" # a room's first event is its creation
        clients = [Viewer(front, model), Viewer(front, model), Colours(front, model), Colours(front, model)]
        pictures = Pictures(web, model)
        for thread in [*clients, pictures, writer]:
            thread.start()
        time.sleep(3)

        marks = [c.mark() for c in clients]
        pictures_before = pictures.failed
        replicas[0].kill()
        time.sleep(2)
        replicas[0].start()
        until(20, replicas[0].ready)
        time.sleep(2)
        worst = account(clients, marks, "replica 1 killed (SIGKILL), started again 2 s later")
        goal("a replica is killed: views and colours continue after", worst, 2, "s", 30)
        goal("and a client connects again, most often", max(c.reconnects - m[1] for c, m in zip(clients, marks)), 1, "", 40)
        hold("%d pictures of a browser failed meanwhile" % (pictures.failed - pictures_before),
             pictures.failed - pictures_before <= 1)

        marks = [c.mark() for c in clients]
        with open(os.environ["RELIGHT_TEST_POSTGRES_PID"], encoding="ascii") as f:
            os.kill(int(f.read()), signal.SIGKILL)
        killed = time.monotonic()
        end = time.monotonic() + 40
        back = None
        while time.monotonic() < end and not (back and writer.times and writer.times[-1] > back):
            ready = subprocess.run(["psql", "-qtc", "SELECT 1", DATABASE], capture_output=True, check=False)
            if ready.returncode == 0 and not back:
                back = time.monotonic()
            time.sleep(0.05)
        resumed = min((t for t in writer.times if back and t > back), default=None)
        account(clients, marks, "PostgreSQL killed (SIGKILL), back after %.1f s" % ((back or end) - killed))
        goal("PostgreSQL is killed: edits go on after it is back", (resumed or end) - (back or end), 3, "s", 30)
        hold("they go on", resumed is not None)

        marks = [c.mark() for c in clients]
        with relight.Client(front) as c:
            slow = c.load(FOLDER + "/ball.obj", size_mm=12, name="slow", samples=12000, wait=False, **BAKE)
        array = until(20, lambda: open("%s/shared/slurm/%s/.slurm/array" % (FOLDER, slow), encoding="ascii").read())
        array = array.split()[0] if array else "0"
        until(20, lambda: subprocess.run(["squeue", "-h", "-t", "R", "-j", array], capture_output=True,
                                         check=False).stdout.strip())
        subprocess.run(["scontrol", "requeue", array + "_0"], check=False)
        done = until(120, lambda: command(front, "info", slow)[1].find("state: ready") > 0)
        account(clients, marks, "a task of a bake lost and queued again by Slurm")
        hold("its bake became ready all the same", bool(done))

        marks = [c.mark() for c in clients]
        pictures_before, refused = pictures.failed, writer.refused
        statuses = []
        for r in replicas:
            statuses.append(r.restart())
            until(20, r.ready)
            time.sleep(1.5)
        account(clients, marks, "both replicas restarted in turn")
        hold("they ended by themselves: %s" % statuses, statuses == [0, 0])
        say("       %d edits were refused meanwhile" % (writer.refused - refused))
        goal("both replicas restart: requests of librelight's clients that failed",
             sum(c.failed - m[2] for c, m in zip(clients, marks)), 0, "", 0)
        goal("and pictures of a browser", pictures.failed - pictures_before, 0, "", 0)

        stop.set()
        for thread in [*clients, pictures, writer]:
            thread.join(20)
        states = [until(10, lambda r=r: room_state(r.socket, room)) for r in replicas]
        texts = [json.dumps(s, sort_keys=True) for s in states]
        missing = [t for t in writer.acknowledged if json.dumps(t)[1:-1] not in texts[0]]
        say("       %d edits were acknowledged, %d refused" % (len(writer.acknowledged), writer.refused))
        goal("acknowledged edits that were lost", len(missing), 0, "", 0)
        hold("both replicas have the same room, sequence %s" % (states[0] or {}).get("sequence"),
             states[0] is not None and texts[0] == texts[1])
        for c in [*clients, pictures]:
            for text in c.errors[:3]:
                say("       %s: %s" % (type(c).__name__.lower(), text))
    finally:
        stop.set()
        for process in [proxy, *[r.process for r in replicas]]:
            process.terminate()
        for process in [proxy, *[r.process for r in replicas]]:
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
        if os.environ.get("RELIGHT_TRY_KEEP") or bad:
            print("logs: " + FOLDER)
        else:
            shutil.rmtree(FOLDER, ignore_errors=True)
    table()
    print("%d of the account's lines are wrong" % len(bad) if bad else "all as it should be")
    sys.exit(1 if bad else 0)


BEGIN = time.monotonic()
main()
