#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""TLS with HAProxy as deploy/cluster/haproxy.cfg has it. It ends at the proxy, for HTTP, WebSocket and frames, or goes
through to the replicas, whose certificates the clients then see; the log names the true client either way; plain text
and TLS 1.1 get nothing.

   proxy_tls.py FOLDER_OF_THE_PROGRAMS FOLDER_OF_THE_PACKAGE FOLDER_OF_HAPROXY_CFG"""
import base64
import http.client
import os
import shutil
import socket
import ssl
import subprocess
import sys
import tempfile
import time

BIN, CONFIG = sys.argv[1], sys.argv[3] + "/haproxy.cfg"
sys.path.insert(0, sys.argv[2])
try:
    import relight
except ImportError as fault:
    print("skipped: the Python client is not built: %s (deploy/dependencies --tests)" % fault)
    sys.exit(77)
for program in ("haproxy", "openssl"):
    if not shutil.which(program):
        print("skipped: no %s; deploy/dependencies --cluster installs it" % program)
        sys.exit(77)

FOLDER = tempfile.mkdtemp(prefix="relight-tls-")
PATIENCE = 60
PROXY = "127.0.0.2"  # the address from which it asks the replicas
started = []


def ports(n):
    sockets = [socket.socket() for _ in range(n)]
    for s in sockets:
        s.bind(("127.0.0.1", 0))
    found = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return found


def until(what, call):
    end = time.monotonic() + PATIENCE
    last = None
    while time.monotonic() < end:
        try:
            got = call()
            if got:
                return got
        except (OSError, relight.RelightError, ssl.SSLError) as error:
            last = error
        assert all(p.poll() is None for p in started), "%s: a program has ended" % what
        time.sleep(0.05)
    raise AssertionError("%s: %s" % (what, last))


def certificate(name):
    """A certificate that signs itself: its file, its key's, and both in one."""
    base = "%s/%s" % (FOLDER, name)
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-keyout", base + ".key", "-out", base + ".pem", "-days", "2", "-subj", "/CN=" + name, "-addext",
                    "subjectAltName=DNS:localhost,IP:127.0.0.1"], check=True, capture_output=True)
    with open(base + ".both", "w", encoding="ascii") as both:
        for part in (".pem", ".key"):
            with open(base + part, encoding="ascii") as f:
                both.write(f.read())
    return base


def start(name, *words, env=None):
    with open("%s/%s.log" % (FOLDER, name), "ab") as log:
        started.append(subprocess.Popen(words, stdout=log, stderr=log, env=env))


def log_of(name):
    with open("%s/%s.log" % (FOLDER, name), encoding="utf-8", errors="replace") as f:
        return f.read()


def replica(number, *words):
    start("replica%d" % number, BIN + "/relightd", "--data", "%s/data%d" % (FOLDER, number), "--store",
          FOLDER + "/shared", "--proxies", PROXY, "--store-poll", "0.2", "--hosts", "*",
          "--listen", "unix:%s/s%d" % (FOLDER, number), *words)


def proxy(name, **values):
    env = {"RELIGHT_FRONT": "127.0.0.1", "RELIGHT_SOURCE": PROXY, "RELIGHT_PROXY_SOCKET": "%s/%s.sock" % (FOLDER, name)}
    env.update({key: str(value) for key, value in values.items()})
    start(name, "haproxy", "-db", "-f", CONFIG, env=dict(os.environ, **env))


def trusting(base):
    context = ssl.create_default_context(cafile=base + ".pem")
    return context


def get(port, path, base):
    c = http.client.HTTPSConnection("localhost", port, timeout=30, context=trusting(base))
    try:
        c.request("GET", path)
        return c.getresponse().status, c.sock.getpeercert()["subject"][0][0][1] if c.sock else None
    finally:
        c.close()


def upgrade(port, base):
    """The answer to a WebSocket's request on a model's path, as a browser of this origin sends it."""
    with trusting(base).wrap_socket(socket.create_connection(("127.0.0.1", port), 30), server_hostname="localhost") as s:
        s.sendall(b"GET /ws/ball HTTP/1.1\r\nHost: localhost:%d\r\nOrigin: https://localhost:%d\r\nUpgrade: websocket\r\n"
                  b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: relight.v1\r\n"
                  b"Sec-WebSocket-Key: %s\r\n\r\n" % (port, port, base64.b64encode(os.urandom(16))))
        return s.recv(4096).split(b"\r\n")[0], s.getsockname()[1]


def refused(port, old):
    """Plain text, or TLS 1.1 where `old`, gets no answer of HTTP."""
    try:
        with socket.create_connection(("127.0.0.1", port), 30) as s:
            if old:
                context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
                context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
                context.set_ciphers("ALL:@SECLEVEL=0")
                context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
                s = context.wrap_socket(s)
            s.sendall(b"GET /readyz HTTP/1.1\r\nHost: localhost\r\n\r\n")
            return not s.recv(4096).startswith(b"HTTP/1.1 200")
    except OSError:
        return True


def by_frames(port, base, model):
    """Colours by librelight's protocol over TLS."""
    with relight.Client("tls:localhost:%d" % port, ca=base + ".pem", timeout=60) as c:
        return c.colors(model, "constant").shape == (6, 3) and c._connection


def main():
    of_proxy, of_replica = certificate("proxy"), certificate("replica")
    plain = [dict(zip(("tcp", "tls", "http"), ports(3))) for _ in range(2)]
    for number, p in enumerate(plain, 1):
        replica(number, "--tls-cert", of_replica + ".pem", "--tls-key", of_replica + ".key", "--tls-loopback=no",
                "--listen", "tcp:127.0.0.1:%d" % p["tcp"], "--listen", "tls:127.0.0.1:%d" % p["tls"],
                "--http", "127.0.0.1:%d" % p["http"])
    front = dict(zip(("http", "tcp", "https", "tls", "through"), ports(5)))
    values = {"RELIGHT_HTTP_PORT": front["http"], "RELIGHT_TCP_PORT": front["tcp"]}
    for number, p in enumerate(plain, 1):
        values.update({"RELIGHT_%d" % number: "127.0.0.1:%d" % p["http"], "RELIGHT_%d_PORT" % number: p["http"],
                       "RELIGHT_%d_TCP" % number: "127.0.0.1:%d" % p["tcp"],
                       "RELIGHT_%d_TLS" % number: "127.0.0.1:%d" % p["tls"]})
    proxy("proxy", RELIGHT_CERTIFICATE=of_proxy + ".both", RELIGHT_HTTPS_PORT=front["https"],
          RELIGHT_TLS_PORT=front["tls"], RELIGHT_PASS_TLS_PORT=front["through"], **values)

    with open(FOLDER + "/ball.obj", "w", encoding="ascii") as f:
        f.write("v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n"
                "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n")

    def load():
        with relight.Client("unix:%s/s1" % FOLDER) as c:
            return c.load(FOLDER + "/ball.obj", size_mm=10, name="ball", samples=200, cube=16, single_points=2,
                          transport="wavelet", material="marble")
    model = until("a model", load)

    # It ends at the proxy.
    until("https at the proxy", lambda: get(front["https"], "/readyz", of_proxy)[0] == 200)
    line, port = upgrade(front["https"], of_proxy)
    assert b" 101 " in line, line
    until("the page's peer", lambda: any("carrier=websocket peer=127.0.0.1:%d" % port in log_of("replica%d" % n)
                                         for n in (1, 2)))
    until("frames at the proxy", lambda: by_frames(front["tls"], of_proxy, model))
    assert refused(front["https"], False) and refused(front["https"], True) and refused(front["tls"], True)
    for wrong in (front["https"], front["tls"]):
        try:
            get(wrong, "/readyz", of_replica)
            raise AssertionError("another's certificate was taken")
        except ssl.SSLCertVerificationError:
            pass
    print("TLS ends at the proxy: HTTP, WebSocket and frames; the replica knows the client")

    # Frames go through: the certificate is the replica's.
    until("frames through the proxy", lambda: by_frames(front["through"], of_replica, model))
    try:
        by_frames(front["through"], of_proxy, model)
        raise AssertionError("the proxy's certificate where TLS goes through")
    except relight.RelightError as error:
        assert "certificate" in str(error).lower(), str(error)
    seen = log_of("replica1") + log_of("replica2")
    assert "peer=%s:" % PROXY not in seen, "the proxy is taken for the client"
    print("TLS of frames goes through to the replica's certificate")

    # HTTPS goes through, to a replica that speaks nothing else.
    http_port, through = ports(2)
    replica(3, "--tls-cert", of_replica + ".pem", "--tls-key", of_replica + ".key", "--http", "127.0.0.1:%d" % http_port)
    unused = ports(2)
    values = {"RELIGHT_%d%s" % (n, end): "127.0.0.1:%d" % http_port for n in (1, 2) for end in ("", "_TCP")}
    values.update({"RELIGHT_1_PORT": http_port, "RELIGHT_2_PORT": http_port, "RELIGHT_HTTP_PORT": unused[0],
                   "RELIGHT_TCP_PORT": unused[1], "RELIGHT_1_HTTPS": "127.0.0.1:%d" % http_port,
                   "RELIGHT_2_HTTPS": "127.0.0.1:%d" % http_port, "RELIGHT_PASS_HTTPS_PORT": through})
    proxy("proxy2", **values)
    until("https through the proxy", lambda: get(through, "/readyz", of_replica)[0] == 200)
    line, port = upgrade(through, of_replica)
    assert b" 101 " in line, line
    until("its peer", lambda: "carrier=websocket peer=127.0.0.1:%d" % port in log_of("replica3"))
    assert refused(through, False) and refused(through, True)
    print("HTTPS goes through, too")


try:
    main()
except BaseException:
    for name in sorted(os.listdir(FOLDER)):
        if name.endswith(".log"):
            print("---- %s\n%s" % (name, log_of(name[:-4])[-3000:]))
    raise
finally:
    for process in started:
        process.terminate()
    for process in started:
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
    shutil.rmtree(FOLDER, ignore_errors=True)
