# SPDX-License-Identifier: MIT
"""A live relightd with an HTTP port, for the tests in Python of that port."""
import http.client
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
import urllib.parse

OCTAHEDRON = (b"v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n"
              b"f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n")
# Of a bake that takes a second.
SMALL = {"size_mm": 10, "material": "marble", "samples": 200, "cube": 16, "single_points": 2}


def sky(width=32, height=16, pixel=(128, 64, 32, 129)):
    """A Radiance picture of one colour, without run lengths."""
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width)
    return head + bytes(pixel) * (width * height)


def no_reports(log):
    """Fails where a sanitizer reported something of a daemon or of a child."""
    assert "Sanitizer: " not in log and ": runtime error: " not in log, log


class Daemon:
    def __init__(self, binaries, *options, environment=None):
        self.binaries, self.options, self.environment = binaries, options, environment
        self.folder = tempfile.mkdtemp(prefix="relightd-web-")
        os.mkdir(self.folder + "/models")
        self.start()

    def start(self):
        self.log_path = self.folder + "/log"
        log = open(self.log_path, "wb")
        self.process = subprocess.Popen(
            [self.binaries + "/relightd", "--data", self.folder + "/data", "--models",
             self.folder + "/models", "--listen", "unix:" + self.folder + "/s",
             "--http", "127.0.0.1:0", "--preview-walks=no", *self.options],
            stderr=log, env={**os.environ, **(self.environment or {})})
        log.close()
        formats = " ".join(self.options)
        self.wait_log('"msg":"start"' if "json" in formats else
                      "msg=start" if "logfmt" in formats else " start version")
        self.port = int(re.search(r"http:127.0.0.1:(\d+)", self.log()).group(1))

    def log(self):
        with open(self.log_path, encoding="utf-8", errors="replace") as f:
            return f.read()

    def wait_log(self, words, seconds=20):
        end = time.monotonic() + seconds
        while words not in self.log():
            assert time.monotonic() < end, "the log does not say %r:\n%s" % (words, self.log())
            time.sleep(0.02)

    def ask(self, method, path, body=None, headers=None, query=None, timeout=600):
        """(status, headers in lower case, bytes)"""
        if query:
            path += "?" + urllib.parse.urlencode(query)
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout)
        try:
            connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    def json(self, method, path, *args, expect=200, **kwargs):
        status, headers, body = self.ask(method, path, *args, **kwargs)
        assert status == expect, (method, path, status, body[:500])
        return json.loads(body)

    def problem(self, status, method, path, *args, **kwargs):
        """The problem document of a request that has to be refused with this status."""
        got, headers, body = self.ask(method, path, *args, **kwargs)
        assert got == status, (method, path[:200], got, status, body[:500])
        assert headers["content-type"] == "application/problem+json", headers
        problem = json.loads(body)
        assert problem["status"] == status and problem["title"] and problem["detail"], problem
        assert problem["request_id"] == headers["x-request-id"], problem
        return problem, headers

    def raw(self, data, seconds=5, half_close=False):
        """Sends bytes; what comes until the daemon closes or the time is over."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=seconds) as s:
            try:
                s.sendall(data)
                if half_close:
                    s.shutdown(socket.SHUT_WR)
            except (BrokenPipeError, ConnectionResetError):
                pass
            out = b""
            try:
                while True:
                    piece = s.recv(65536)
                    if not piece:
                        return out
                    out += piece
            except (socket.timeout, ConnectionResetError):
                return out

    def metrics(self):
        """{name with labels: value}"""
        lines = self.ask("GET", "/metrics")[2].decode().splitlines()
        return {k: float(v) for k, v in (line.rsplit(" ", 1) for line in lines if line[:1] != "#")}

    def wait_metric(self, name, value, seconds=10):
        end = time.monotonic() + seconds
        while self.metrics().get(name) != value:
            assert time.monotonic() < end, (name, self.metrics().get(name), value)
            time.sleep(0.05)

    def bake(self, name="small.obj", **more):
        """Uploads and bakes the octahedron; its id."""
        loaded = json.loads(self.ask("POST", "/v1/models", OCTAHEDRON,
                                     query={"name": name, **SMALL, **more})[2])
        if loaded.get("job"):
            self.ask("GET", "/v1/jobs/%s/events" % loaded["job"])
        return loaded["model"]

    def stop(self, how=signal.SIGTERM, seconds=30):
        if self.process.poll() is None:
            self.process.send_signal(how)
        try:
            status = self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise
        no_reports(self.log())
        return status

    def end(self):
        """Has to leave with status 0; removes the folder."""
        try:
            status = self.stop()
            assert status == 0, "status %s\n%s" % (status, self.log()[-3000:])
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)


def run(tests, make):
    """Each test with one daemon; its name, and the log where it fails."""
    daemon = make()
    try:
        for test in tests:
            print("    " + test.__name__.replace("_", " "), flush=True)
            try:
                test(daemon)
            except BaseException:
                print(daemon.log()[-4000:])
                raise
        daemon.end()
    finally:
        if daemon.process.poll() is None:
            daemon.process.kill()
        shutil.rmtree(daemon.folder, ignore_errors=True)
