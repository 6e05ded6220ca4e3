#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Operating relightd: probes, metrics, lame duck and drain, messages to the service manager, log
formats, and the id of a request from its arrival to its children.  operation.py BIN"""
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

from web import Daemon, OCTAHEDRON, SMALL, run, sky


class Notify:
    """A service manager's notification socket."""

    def __init__(self):
        self.folder = tempfile.mkdtemp(prefix="relightd-notify-")
        self.path = self.folder + "/s"
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        self.seen = []

    def wait(self, pattern, seconds=20):
        """The first message from here on that has the pattern; those before it are passed."""
        end = time.monotonic() + seconds
        while True:
            self.socket.settimeout(max(0.01, end - time.monotonic()))
            try:
                text = self.socket.recv(4096).decode()
            except socket.timeout:
                raise AssertionError("no message %r in %r" % (pattern, self.seen[-20:])) from None
            self.seen.append(text)
            found = re.search(pattern, text, re.M)
            if found:
                return found

    def wait_exit(self, process, seconds=30):
        """The status of the process, which ends whether its messages are read or not."""
        return process.wait(seconds)

    def close(self):
        self.socket.close()
        shutil.rmtree(self.folder)


# ---- /metrics

NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = r'%s="(?:[^"\\\n]|\\["\\n])*"' % r"[a-zA-Z_][a-zA-Z0-9_]*"
SAMPLE = re.compile(r"(%s)(?:\{(%s(?:,%s)*)\})? (\S+)$" % (NAME, LABEL, LABEL))


def check_exposition(text):
    """The rules of the text format 0.0.4 and those of `promtool check metrics`."""
    kinds, helped, seen, closed, current = {}, set(), set(), set(), None
    assert text.endswith("\n")
    for line in text[:-1].split("\n"):
        head = re.match(r"# (HELP|TYPE) (%s) (.+)$" % NAME, line)
        if head:
            what, name, rest = head.groups()
            if what == "HELP":
                assert name not in helped, "two HELP of " + name
                helped.add(name)
            else:
                assert name not in kinds and rest in ("counter", "gauge", "histogram"), line
                kinds[name] = rest
                if current:
                    closed.add(current)
                current = name
                assert name not in closed, name + " is in two places"
            continue
        sample = SAMPLE.match(line)
        assert sample, "not a sample: " + line
        name, labels, value = sample.groups()
        family = re.sub(r"_(bucket|sum|count)$", "", name) if kinds.get(current) == "histogram" else name
        assert family == current and family in helped, line
        assert (name, labels) not in seen, "twice: " + line
        seen.add((name, labels))
        float(value)
        kind = kinds[family]
        assert (kind == "counter") == name.endswith("_total"), "the name does not fit its type: " + line
        if kind != "gauge":
            assert float(value) >= 0, line
        assert "le=" not in (labels or "") or kind == "histogram", line
    return kinds, seen


def check_sums(metrics):
    """The sum of what a histogram counted lies between the sums of the bounds of its buckets."""
    buckets = {}
    for key, n in metrics.items():
        found = re.match(r'(\w+)_bucket\{(.*,)?le="([^"]+)"\}$', key)
        if found:
            name, label, le = found.groups()
            of = name + "%s" + ("{%s}" % label[:-1] if label else "")
            buckets.setdefault(of, []).append((float(le), n))
    assert any("batch_size" in of for of in buckets)
    for of, rows in buckets.items():
        least = most = below = counted = 0
        for le, n in sorted(rows):
            least += below * (n - counted)
            most += le * (n - counted) if n > counted else 0
            below, counted = le, n
        assert least <= metrics[of % "_sum"] <= most * (1 + 1e-9), (of, rows, metrics[of % "_sum"])
        assert counted == metrics[of % "_count"], of


def metrics_have_the_format(d):
    text = d.ask("GET", "/metrics")[2].decode()
    kinds, seen = check_exposition(text)
    d.bake()
    assert d.ask("GET", "/v1/models/small/image?env=constant&size=32x32")[0] == 200
    d.problem(404, "GET", "/v1/models/nothing")
    metrics = d.metrics()
    assert metrics["relightd_batch_size_count"] >= 1
    check_sums(metrics)
    kinds, seen = check_exposition(d.ask("GET", "/metrics")[2].decode())
    assert metrics['relightd_requests_total{operation="image",outcome="ok"}'] == 1
    assert metrics['relightd_requests_total{operation="info",outcome="not_found"}'] == 1
    subprocess.run([sys.argv[1] + "/relight", "-s", "unix:" + d.folder + "/s", "ping"], check=True, capture_output=True)
    assert d.metrics()['relightd_requests_total{operation="hello",outcome="ok"}'] == 1
    assert metrics['relightd_bakes_total{outcome="done"}'] == 1
    assert metrics['relightd_carrier_connections_total{carrier="http"}'] >= 4
    for name in ("request_seconds", "queue_seconds", "compute_seconds", "batch_size"):
        assert kinds["relightd_" + name] == "histogram", name
    for name in ("principals", "views_open", "resource_held", "resource_limit", "memory_limit_bytes",
                 "models_bytes", "cache_bytes", "cache_limit_bytes"):
        if name != "memory_limit_bytes":
            assert kinds["relightd_" + name] == "gauge", name
    buckets = [v for k, v in metrics.items() if k.startswith('relightd_compute_seconds_bucket{operation="image"')]
    assert buckets == sorted(buckets)
    assert buckets[-1] == metrics['relightd_compute_seconds_count{operation="image"}'] == 1
    promtool = shutil.which("promtool")
    if promtool:
        said = subprocess.run([promtool, "check", "metrics"], input=d.ask("GET", "/metrics")[2],
                              capture_output=True, check=False)
        assert said.returncode == 0 and not said.stderr, said
        print("        promtool has no complaint")
    else:
        print("        (no promtool here: the checker of this test alone)")


# ---- probes

def readiness_follows_the_data_folder(d):
    assert d.ask("GET", "/readyz")[::2] == (200, b"ready\n")
    work = d.folder + "/data/work"
    os.rename(work, work + ".away")
    try:
        end = time.monotonic() + 20
        while d.ask("GET", "/readyz")[0] != 503:
            assert time.monotonic() < end, "an unwritable data folder is not seen"
            time.sleep(0.2)
        assert b"data folder" in d.ask("GET", "/readyz")[2]
        assert d.ask("GET", "/healthz")[0] == 200
    finally:
        os.rename(work + ".away", work)
    end = time.monotonic() + 20
    while d.ask("GET", "/readyz")[0] != 200:
        assert time.monotonic() < end
        time.sleep(0.2)


# ---- ids of requests

def wait_for_line(d, pattern):
    """The log has a thread of its own: a line may come after the answer."""
    end = time.monotonic() + 20
    while not re.search(pattern, d.log()):
        assert time.monotonic() < end, pattern
        time.sleep(0.05)


def an_id_goes_from_arrival_to_children(d):
    loaded = d.json("POST", "/v1/models", OCTAHEDRON, {"X-Request-Id": "the-load"}, expect=202,
                    query={"name": "ids.obj", **SMALL, "seed": 5})
    d.ask("GET", "/v1/jobs/%s/events" % loaded["job"])
    d.problem(422, "POST", "/v1/models/ids/image", b"#?RADIANCE broken", {"X-Request-Id": "the-light"})
    for pattern in (r"begin request=the-load .* op=LOAD", r"access request=the-load .* op=LOAD outcome=ok",
                    r"job id=\S+ request=the-load model=\S+ started", r"job id=\S+ request=the-load .* done",
                    r"http request=the-load method=POST path=/v1/models status=202",
                    r"decode request=the-light crashed=0 error=", r"refused request=the-light .*op=IMAGE"):
        wait_for_line(d, pattern)


def a_child_has_the_id(binaries):
    """prt is started with it: here a program in its place shows it."""
    folder = tempfile.mkdtemp(prefix="relightd-prt-")
    program = folder + "/prt"
    with open(program, "w", encoding="utf-8") as f:
        f.write("#!/bin/sh\necho \"warning: id $RELIGHT_REQUEST_ID\" >&2\nexit 1\n")
    os.chmod(program, 0o700)
    d = Daemon(binaries, "--prt", program)
    try:
        loaded = d.json("POST", "/v1/models", OCTAHEDRON, {"X-Request-Id": "seen-by-prt"}, expect=202,
                        query={"name": "a.obj", **SMALL})
        text = d.ask("GET", "/v1/jobs/%s/events" % loaded["job"])[2]
        assert b"event: failed" in text, text
        d.wait_log('request=seen-by-prt output="warning: id seen-by-prt"')
    finally:
        d.end()
        shutil.rmtree(folder)


def log_formats(binaries):
    d = Daemon(binaries, "--log-format", "json", "--log-access", "event")
    try:
        d.problem(404, "GET", "/v1/models/%22%5Cn", headers={"X-Request-Id": "json-1"})
        d.wait_log('"request":"json-1"')
        lines = [json.loads(line) for line in d.log().splitlines()]
        assert all(line["time"] and line["level"] in ("error", "warning", "event") for line in lines)
        access = [x for x in lines if x.get("request") == "json-1" and x["msg"] == "access"]
        assert access and access[0]["op"] == "INFO" and access[0]["outcome"] == "not_found", lines
    finally:
        d.stop()
        lines = [json.loads(line) for line in d.log().splitlines()]
        assert lines[-1]["msg"] == "stop"
        d.end()
    d = Daemon(binaries, "--log-format", "logfmt")
    try:
        d.problem(404, "GET", "/v1/models/a%20b")
        text = d.log()
    finally:
        d.end()
    field = r'[a-z_]+=(?:"(?:[^"\\]|\\.)*"|[^ "=]*)'
    for line in text.splitlines():
        assert re.fullmatch(r"%s(?: %s)*" % (field, field), line), line


# ---- the service manager, reload, and leaving

def messages_to_the_service_manager(binaries):
    notify = Notify()
    d = Daemon(binaries, "--lame-duck", "1.5", "--drain", "5",
               environment={"NOTIFY_SOCKET": notify.path, "WATCHDOG_USEC": "400000"})
    try:
        status = notify.wait(r"^READY=1\nSTATUS=(.*)$").group(1)
        assert status == "0 connections, 0 requests, 0 bakes", status
        notify.wait("^WATCHDOG=1$")
        notify.wait("^WATCHDOG=1$")
        # A connection with a request that stays open, and its GOAWAY.
        stream = socket.create_connection(("127.0.0.1", d.port))
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(d.folder + "/s")
            notify.wait("^STATUS=1 connections, 0 requests, 0 bakes$")
        stream.close()
        before = time.clock_gettime(time.CLOCK_MONOTONIC) * 1e6
        d.process.send_signal(signal.SIGHUP)
        at = int(notify.wait(r"^RELOADING=1\nMONOTONIC_USEC=(\d+)$").group(1))
        assert before - 1e6 <= at <= time.clock_gettime(time.CLOCK_MONOTONIC) * 1e6
        notify.wait("^READY=1$")
        d.wait_log("reload done changed=0 needs_restart=0")
        # Lame duck: probes fail, all else goes on.
        d.process.send_signal(signal.SIGTERM)
        notify.wait(r"^STOPPING=1\nSTATUS=leaving: ")
        assert d.ask("GET", "/readyz")[0] == 404
        assert d.ask("GET", "/healthz")[0] == 200
        assert d.ask("GET", "/v1/models")[0] == 200
        notify.wait("^WATCHDOG=1$")
        notify.wait(r"^STOPPING=1\nSTATUS=draining: ")
        assert notify.wait_exit(d.process) == 0
        log = d.log()
        assert log.index("leave signal=") < log.index("drain requests=") < log.index(" stop\n")
    finally:
        d.end()
        notify.close()


def a_manager_that_does_not_read(binaries):
    """The loop goes on, and what the manager must know comes when it reads."""
    notify = Notify()
    d = Daemon(binaries, environment={"NOTIFY_SOCKET": notify.path, "WATCHDOG_USEC": "20000"})
    try:
        for _ in range(3):
            time.sleep(0.5)  # of which a tenth fills the queue
            assert d.ask("GET", "/healthz")[0] == 200
        d.process.send_signal(signal.SIGHUP)
        d.wait_log("reload done changed=0 needs_restart=0")
        notify.wait("^READY=1$")
        notify.wait("^RELOADING=1$")
        notify.wait("^READY=1$")
        notify.wait("^WATCHDOG=1$")
        time.sleep(0.5)
        d.process.send_signal(signal.SIGTERM)
        assert notify.wait_exit(d.process) == 0
    finally:
        d.end()
        notify.close()


def goaway_and_a_second_signal(binaries):
    d = Daemon(binaries, "--lame-duck", "60", "--drain", "60")
    try:
        began = time.monotonic()
        d.process.send_signal(signal.SIGTERM)
        d.wait_log("leave signal=")
        assert d.ask("GET", "/readyz")[0] == 404
        with socket.socket(socket.AF_UNIX) as late:  # listeners are open still
            late.connect(d.folder + "/s")
        d.process.send_signal(signal.SIGTERM)
        assert d.process.wait(30) == 0
        assert time.monotonic() - began < 30, "a second signal does not skip the lame duck"
    finally:
        d.end()


def what_cannot_be_reloaded_is_said(binaries):
    d = Daemon(binaries)
    conf = d.folder + "/conf"
    d.stop()
    with open(conf, "w", encoding="utf-8") as f:
        f.write("deadline = 50\nthreads = 1\n")
    d.options = ("--config", conf)
    d.start()
    try:
        with open(conf, "w", encoding="utf-8") as f:
            f.write("deadline = 40\nthreads = 2\nlame-duck = 1\n")
        d.process.send_signal(signal.SIGHUP)
        d.wait_log("reload done changed=2 needs_restart=1")
        assert 'option=threads: the new value "2" needs a restart' in d.log()
        with open(conf, "w", encoding="utf-8") as f:
            f.write("deadline = many\n")
        d.process.send_signal(signal.SIGHUP)
        d.wait_log("reload refused, nothing changed: ")
        assert d.ask("GET", "/readyz")[0] == 200
        checked = subprocess.run([binaries + "/relightd", "--check", "--config", conf],
                                 capture_output=True, check=False)
        assert checked.returncode == 2 and b"deadline" in checked.stderr, checked
    finally:
        d.end()


def main():
    binaries = sys.argv[1]
    run([metrics_have_the_format, readiness_follows_the_data_folder, an_id_goes_from_arrival_to_children],
        lambda: Daemon(binaries, "--log", "trace"))
    for test in (a_child_has_the_id, log_formats, messages_to_the_service_manager,
                 a_manager_that_does_not_read,
                 goaway_and_a_second_signal, what_cannot_be_reloaded_is_said):
        print("    " + test.__name__.replace("_", " "), flush=True)
        test(binaries)


main()
