#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The HTTP API of a live relightd: models, pictures, colours, uploads, jobs and their errors, and
what a hostile client can try.  http_api.py BIN"""
import array
import hashlib
import http.client
import json
import os
import re
import socket
import sys
import threading
import time

from web import Daemon, OCTAHEDRON, SMALL, run, sky

state = {}


def a_model_is_uploaded_and_baked(d):
    status, headers, body = d.ask("POST", "/v1/models", OCTAHEDRON,
                                  query={"name": "small.obj", **SMALL})
    loaded = json.loads(body)
    assert status == 202 and loaded["state"] == "baking", (status, loaded)
    assert headers["location"] == "/v1/models/" + loaded["model"]
    events = d.ask("GET", "/v1/jobs/%s/events" % loaded["job"])
    assert events[1]["content-type"] == "text/event-stream"
    blocks = [dict(line.split(": ", 1) for line in block.splitlines())
              for block in events[2].decode().split("\n\n") if block and block[0] != ":"]
    assert [int(b["id"]) for b in blocks] == list(range(1, len(blocks) + 1))
    last = json.loads(blocks[-1]["data"])
    assert blocks[-1]["event"] == "done" and last["state"] == "done" and last["fraction"] == 1
    # A reconnecting EventSource is told that nothing follows.
    again = d.ask("GET", "/v1/jobs/%s/events" % loaded["job"], headers={"Last-Event-ID": "3"})
    assert again[0] == 204 and again[2] == b""
    assert d.json("GET", "/v1/jobs/" + loaded["job"])["state"] == "done"
    # The same model again: no bake.
    same = d.json("POST", "/v1/models", OCTAHEDRON, query={"name": "small.obj", **SMALL})
    assert same["model"] == loaded["model"] and same["state"] == "ready", same
    state["model"] = loaded["model"]


def models_are_listed_and_described(d):
    listed = d.json("GET", "/v1/models")["models"]
    assert [m["model"] for m in listed] == [state["model"]]
    info = d.json("GET", "/v1/models/small")
    assert info["n_vertex"] == 6 and info["state"] == "ready"
    assert info["material"]["name"] == "marble" and info["blocks"][0]["n_triangle"] == 8
    d.problem(404, "GET", "/v1/models/nothing")


def every_format(d, image):
    """Each format of the document is drawn, and an ending draws what its word does."""
    schemas = json.loads(d.ask("GET", "/v1/openapi.json")[2])["components"]["schemas"]
    query = "env=constant&size=32x24"
    raw = {"rgb8": 3, "f16": 6}  # bytes of a pixel
    for word in schemas["PictureFormat"]["enum"]:
        status, headers, body = d.ask("GET", image + "?format=" + word + "&" + query)
        assert status == 200, (word, body[:300])
        kind = headers["content-type"]
        assert kind == "application/octet-stream" if word in raw else kind.startswith("image/"), (word, kind)
        assert word not in raw or len(body) == raw[word] * 32 * 24, (word, len(body))
    for ending in schemas["PictureEnding"]["enum"]:
        by_word = d.ask("GET", image + "?format=" + ending + "&" + query)
        by_ending = d.ask("GET", image + "." + ending + "?" + query)
        assert by_ending[2] == by_word[2] and by_ending[1]["content-type"] == by_word[1]["content-type"], ending


def headers_of_pictures(d, image):
    """A picture's headers have its engine, its model's generation, and parts of the time that make no more than all."""
    generation = d.json("GET", "/v1/models/small")["generation"]
    for query, engine in (("", "wavelet"), ("&engine=texture", "texture"), ("&engine=splat", "splat")):
        headers = d.ask("GET", image + "?env=constant:0.3,0.2,0.1&size=40x30" + query)[1]
        assert headers["x-relight-engine"] == engine and headers["x-relight-size"] == "40x30", headers
        assert int(headers["x-relight-generation"]) == generation and float(headers["x-relight-error-bound"]) > 0, headers
        parts = dict(part.split(";dur=") for part in headers["server-timing"].split(", "))
        assert list(parts) == ["queue", "light", "relight", "raster", "shade", "encode", "total"], headers
        ms = {name: float(x) for name, x in parts.items()}
        total = ms.pop("total")
        assert 0 < sum(ms.values()) <= total + 0.1 and ms["relight"] > 0, headers
        # Engines in image space draw no mesh, and contract no light with a bake.
        assert (ms["light"] + ms["raster"] > 0) == (engine == "wavelet"), headers


def pictures(d):
    image = "/v1/models/small/image"
    status, headers, jpeg = d.ask("GET", image + ".jpg?env=constant&size=120x90&rotate=30")
    assert status == 200 and headers["content-type"] == "image/jpeg" and jpeg[:2] == b"\xff\xd8"
    assert headers["x-relight-size"] == "120x90" and "total;dur=" in headers["server-timing"]
    same = d.ask("GET", image + ".jpg?env=constant&size=120x90&rotate=30",
                 headers={"If-None-Match": headers["etag"]})
    assert same[0] == 304 and same[2] == b"" and same[1]["etag"] == headers["etag"]
    other = d.ask("GET", image + ".jpg?env=constant:1,0,0&size=120x90",
                  headers={"If-None-Match": headers["etag"]})
    assert other[0] == 200 and other[2] != jpeg
    head = d.ask("HEAD", image + ".jpg?env=constant&size=120x90&rotate=30")
    assert head[0] == 200 and head[2] == b"" and int(head[1]["content-length"]) == len(jpeg)
    # A picture of light as the body gives what its upload gives.
    status, headers, png = d.ask("POST", image + "?size=64x48&format=png&rotate=90", sky())
    assert status == 200 and png[:4] == b"\x89PNG", (status, png[:300])
    name = hashlib.sha256(sky()).hexdigest()
    assert d.ask("GET", image + ".png?size=64x48&rotate=90&env=" + name)[2] == png
    assert d.ask("GET", image + ".png?size=64x48&rotate=90&env=env:" + name)[2] == png
    body = {"lights": [{"env": "env:" + name, "rotate_deg": 90}],
            "picture": {"width": 64, "height": 48, "format": "png"}}
    json_type = {"Content-Type": "application/json"}
    assert d.ask("POST", image, json.dumps(body), json_type)[2] == png
    assert d.ask("POST", image + ".png", json.dumps(dict(body, model="small")), json_type)[2] == png
    # What the path or the query says, the body may not say otherwise.
    for path, more, parameter in (("", {"model": "other"}, "model"), ("?rotate=20", {}, "rotate"),
                                  ("?gain=1,1,1", {}, "gain"), (".jpg", {}, "picture.format"),
                                  (".png", {"picture": {"format": "jpeg"}}, "picture.format")):
        problem, _ = d.problem(400, "POST", image + path, json.dumps(dict(body, **more)), json_type)
        assert problem["parameter"] == parameter, (path, problem)
    every_format(d, image)
    headers_of_pictures(d, image)
    exr = d.ask("GET", image + ".exr?env=constant&size=32x32&camera=0,0,3:0,0,0:0,1,0:40")
    assert exr[0] == 200 and exr[2][:4] == b"\x76\x2f\x31\x01"
    for query, parameter in (("size=0x5", "size"), ("size=5", "size"), ("rotate=x", "rotate"),
                             ("rotate=nan", "rotate"), ("camera=1,2", "camera"),
                             ("quality=1e9", "picture.quality"), ("format=gif", "format"), ("foo=1", "foo"),
                             ("rotate=1&rotate=2", "rotate"), ("engine=fast", "engine"),
                             ("deadline_ms=0", "deadline_ms")):
        problem, _ = d.problem(400, "GET", image + "?env=constant&" + query)
        assert problem.get("parameter") == parameter, (query, problem)
    # A number out of its range: the problem has the range, and its unit where there is one.
    for query, *wanted in (("quality=101", "picture.quality", 1, 100, None),
                           ("exposure=99", "picture.exposure_ev", -40, 40, "stops"),
                           ("camera=0,0,3:0,0,0:0,1,0:170", "picture.camera.fovy_deg", 0, 170, "degrees"),
                           ("rotate=1e9", "lights[0].rotate_deg", -1e6, 1e6, "degrees"),
                           ("max_error=-1", "shade.max_error", 0, 1e9, None),
                           *((("deadline_ms=" + wrong), "deadline_ms", 1, 3.6e6, None)
                             for wrong in ("0", "0.9", "3600001", "1e9", "nan", "inf", "-5", "5x", ""))):
        problem, _ = d.problem(400, "GET", image + "?env=constant&" + query)
        assert [problem.get(k) for k in ("parameter", "minimum", "maximum", "unit")] == wanted, (query, problem)
    assert "/v1/openapi.json" in d.problem(400, "GET", image + "?env=constant&foo=1")[0]["hint"]
    assert "relight models" in d.problem(404, "GET", "/v1/models/nothing")[0]["hint"]
    assert d.ask("GET", image + "?env=constant&size=32x32&deadline_ms=3600000")[0] == 200
    for query, why in (("foo=1", "not known"), ("rotate=1&rotate=2", "given twice"), ("rotate=1&foo=1&foo=2", "not known")):
        assert why in d.problem(400, "GET", image + "?env=constant&" + query)[0]["detail"], query
    d.problem(404, "GET", image + ".gif?env=constant")
    problem, _ = d.problem(400, "POST", image + "?env=constant", sky())
    assert problem["parameter"] == "env"
    d.problem(422, "POST", image, b"no picture")
    for wrong in ({"lights": [{"rotat": 1}]}, {"lights": {}}, {"lights": [{"env": 5}]},
                  {"picture": {"width": -1}}, {"picture": {"format": 3}}, []):
        d.problem(400, "POST", image, json.dumps(wrong), json_type)
    d.problem(400, "POST", image, b"{", json_type)
    d.problem(413, "POST", image, b" " * 70000, json_type)


def colours(d):
    raw = d.ask("GET", "/v1/models/small/colors?env=constant")
    values = array.array("f", raw[2])
    head = {k: int(raw[1]["x-relight-" + k]) for k in ("vertices", "planes", "plane-bytes")}
    assert head == {"vertices": 6, "planes": 1, "plane-bytes": 72} and len(values) == 18, head
    rows = d.ask("GET", "/v1/models/small/colors.csv?env=constant")[2].decode().splitlines()
    assert rows[0] == "vertex,r,g,b" and len(rows) == 7
    for i, row in enumerate(rows[1:]):
        assert list(array.array("f", map(float, row.split(",")[1:]))) == list(values[3 * i:3 * i + 3])
    npy = d.ask("GET", "/v1/models/small/colors?format=npy&env=constant")
    assert npy[1]["content-type"] == "application/x-npy" and npy[2].endswith(raw[2])
    for name, size in (("f16", 36), ("rgb9e5", 24), ("srgb8", 24)):
        assert len(d.ask("GET", "/v1/models/small/colors?env=constant&format=" + name)[2]) == size
    assert len(d.ask("POST", "/v1/models/small/colors", sky())[2]) == 72
    assert d.problem(400, "GET", "/v1/models/small/colors?format=f64")[0]["parameter"] == "format"
    # A body's format goes with files of numbers where it is the floats that they are made of.
    json_type = {"Content-Type": "application/json"}
    for ending in ("csv", "npy"):
        path = "/v1/models/small/colors." + ending
        body = {"lights": [{"env": "constant"}], "format": "f32"}
        same = d.ask("POST", path, json.dumps(body), json_type)
        assert same[0] == 200 and same[2] == d.ask("GET", path + "?env=constant")[2], same
        for other in ("f16", "rgb9e5", "srgb8", "coefficients"):
            body["format"] = other
            problem, _ = d.problem(400, "POST", path, json.dumps(body), json_type)
            assert problem["parameter"] == "format", problem


def uploads(d):
    blob = os.urandom(3 << 20) + b"end"  # four chunks
    name = hashlib.sha256(blob).hexdigest()
    d.problem(404, "GET", "/v1/blobs/" + name)
    d.problem(404, "GET", "/v1/blobs/nonsense")
    got = d.json("POST", "/v1/blobs", blob, query={"name": "noise.bin"}, expect=201)
    assert got == {"hash": name, "complete": True, "received": len(blob)}
    assert d.json("GET", "/v1/blobs/" + name)["complete"]
    assert d.json("POST", "/v1/blobs", blob, expect=201)["hash"] == name  # it was there
    # By its hash, in two parts, the second one later.
    blob = os.urandom(100000)
    name = hashlib.sha256(blob).hexdigest()
    part = d.json("PUT", "/v1/blobs/%s?size=100000" % name, blob[:40000], expect=202)
    assert part == {"hash": name, "complete": False, "received": 40000}
    assert d.json("GET", "/v1/blobs/%s?size=100000" % name)["received"] == 40000
    d.problem(400, "PUT", "/v1/blobs/%s?size=100000&offset=50000" % name, blob[50000:])
    d.json("PUT", "/v1/blobs/%s?size=100000&offset=40000" % name, blob[40000:], expect=201)
    problem, _ = d.problem(422, "PUT", "/v1/blobs/" + "0" * 64, b"other bytes")
    assert problem["code"] == "hash"
    d.problem(400, "POST", "/v1/blobs")
    # Without its hash a file comes as a whole: nobody could send the rest.
    problem, _ = d.problem(400, "POST", "/v1/blobs?size=10", b"begun")
    assert problem["parameter"] == "size", problem
    problem, headers = d.problem(413, "POST", "/v1/blobs", b"x" * 5000001)
    assert problem["maximum"] == 5000000
    d.json("POST", "/v1/blobs", b"x" * 5000000, expect=201)
    d.problem(415, "POST", "/v1/blobs", b"x", {"Content-Type": "multipart/form-data; boundary=x"})
    d.problem(415, "POST", "/v1/blobs", b"{}", {"Content-Type": "application/json"})
    d.problem(400, "POST", "/v1/models", OCTAHEDRON)  # no name
    d.problem(400, "POST", "/v1/models")  # no model
    d.problem(422, "POST", "/v1/models?name=x.glb&preview=yes&size_mm=1", b"no model")
    d.wait_metric('relightd_resource_held{resource="uploads"}', 0)


def methods_and_request_ids(d):
    _, headers = d.problem(405, "PATCH", "/v1/models")
    assert headers["allow"] == "GET, HEAD, POST"
    _, headers = d.problem(405, "DELETE", "/healthz")
    assert headers["allow"] == "GET, HEAD"
    # What has no content has no type of it (RFC 9110, 15.4.5).
    _, headers, _ = d.ask("GET", "/v1/openapi.json")
    same = d.ask("GET", "/v1/openapi.json", headers={"If-None-Match": headers["etag"]})
    assert same[0] == 304 and "content-type" in headers and "content-type" not in same[1], same
    d.problem(404, "GET", "/v1/nothing")
    assert d.ask("GET", "/healthz", headers={"X-Request-Id": "from-me.1"})[1]["x-request-id"] == "from-me.1"
    d.problem(400, "GET", "/healthz", headers={"X-Request-Id": "a b"})
    d.problem(400, "GET", "/healthz", headers={"X-Request-Id": "x" * 65})
    longest = "x" * 64
    assert d.ask("GET", "/healthz", headers={"X-Request-Id": longest})[1]["x-request-id"] == longest
    d.problem(404, "GET", "/v1/models/nothing", headers={"X-Request-Id": "found-in-the-log"})
    d.wait_log("request=found-in-the-log")
    # Keep-alive: several requests on one connection, one of them with a body; GETs may be pipelined.
    connection = http.client.HTTPConnection("127.0.0.1", d.port, timeout=20)
    for method, path, body in (("GET", "/healthz", None), ("POST", "/v1/blobs", b"hello"),
                               ("GET", "/v1/models", None), ("POST", "/v1/blobs", b"hello again")):
        connection.request(method, path, body)
        answer = connection.getresponse()
        assert answer.status in (200, 201) and answer.read(), (method, path, answer.status)
    connection.close()
    text = d.raw(b"GET /v1/models HTTP/1.1\r\nHost: localhost\r\n\r\n" * 3 +
                 b"GET /readyz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", 5)
    assert text.count(b"HTTP/1.1 200") == 4, text
    # Behind a body it is refused, and nobody else waits for it.
    with socket.create_connection(("127.0.0.1", d.port), timeout=20) as s:
        s.sendall(b"POST /v1/models/small/image HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nhello"
                  + b"GET /readyz HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20)
        assert d.ask("GET", "/readyz", timeout=10)[0] == 200
    # POST without a length has no body, and ends its connection.
    text = d.raw(b"POST /v1/models HTTP/1.1\r\nHost: localhost\r\n\r\nGET /healthz HTTP/1.1\r\n"
                 b"Host: localhost\r\n\r\n", 5)
    assert text.count(b"HTTP/1.1") <= 1, text


def a_foreign_page_gets_nothing(d):
    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"},
                    {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}):
        assert d.ask("GET", "/v1/models", headers=headers)[0] == 403, headers
    assert d.ask("GET", "/v1/models", headers={"Sec-Fetch-Site": "cross-site",
                                              "Sec-Fetch-Mode": "navigate"})[0] == 200


def attacks_on_the_first_part(d):
    host = b" HTTP/1.1\r\nHost: localhost\r\n\r\n"
    for target in (b"/v1/models?" + b"a" * 10000000, b"/v1/" + b"x" * 5000,
                   b"/v1/models?" + b"&".join(b"a%d=1" % i for i in range(1000)),
                   b"/v1/models/%00/image", b"/v1/models?x=%00", b"/v1/models/%ff%fe",
                   b"/v1/models/%0d%0aX-Evil:1", b"/v1/models/../../etc/passwd",
                   b"/v1/models/%2e%2e%2f%2e%2e%2fetc%2fpasswd", b"/v1/models?path=/etc/passwd"):
        answer = d.raw(b"GET " + target + host, 2)
        assert not answer.startswith(b"HTTP/1.1 200") and b"root:" not in answer, (target[:60], answer)
        assert b"\r\nX-Evil" not in answer
    for lines in (b"Content-Length: -1", b"Content-Length: 5, 5", b"Content-Length: 1e3",
                  b"Content-Length: 99999999999999999999", b"Transfer-Encoding: gzip, chunked",
                  b"Transfer-Encoding: chunked\r\nTransfer-Encoding: chunked",
                  b"Content-Length: 5\r\nTransfer-Encoding: chunked"):
        answer = d.raw(b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\n" + lines +
                       b"\r\n\r\n5\r\nhello\r\n0\r\n\r\nGET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n", 2)
        assert answer.count(b"HTTP/1.1") <= 1 and b"HTTP/1.1 20" not in answer, (lines, answer)
    # A body with GET, and one that goes on past its length: the rest is another request.
    assert b"HTTP/1.1 400" in d.raw(b"GET /v1/models HTTP/1.1\r\nHost: localhost\r\n"
                                    b"Content-Length: 5\r\n\r\nhello", 2)
    answer = d.raw(b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nhello, world", 2)
    assert answer.count(b"HTTP/1.1") <= 1 and b"HTTP/1.1 20" not in answer[12:], answer


def chunked_bodies(d):
    head = b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
    data = bytes(range(256)) * 8000
    framed = b"".join(b"%X;x=y\r\n%s\r\n" % (len(p), p)
                      for p in (data[:1], data[1:70000], data[70000:])) + b"0\r\nA: b\r\n\r\n"
    before = d.metrics()["relightd_bytes_in_total"]
    with socket.create_connection(("127.0.0.1", d.port), timeout=20) as s:
        for i in range(0, len(head + framed), 60001):  # cut anywhere
            s.sendall((head + framed)[i:i + 60001])
        answer = b""
        while piece := s.recv(65536):  # it closes behind its answer
            answer += piece
    assert b"HTTP/1.1 20" in answer and hashlib.sha256(data).hexdigest().encode() in answer, answer
    assert d.metrics()["relightd_bytes_in_total"] - before == len(data)
    # A request behind the end is not answered; nothing is kept of it.
    answer = d.raw(head + b"5\r\nhello\r\n0\r\n\r\nGET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n", 5)
    assert answer.count(b"HTTP/1.1") == 1 and hashlib.sha256(b"hello").hexdigest().encode() in answer
    answer = d.raw(head + b"00000005\r\nhello\r\n00000000\r\n\r\n", 5)  # the longest size
    assert hashlib.sha256(b"hello").hexdigest().encode() in answer, answer
    json = b'{"path": "nothing.glb"}'
    answer = d.raw(b"POST /v1/models HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
                   b"Transfer-Encoding: chunked\r\n\r\n%x\r\n%s\r\n0\r\n\r\n" % (len(json), json), 5)
    assert b"nothing.glb: no such file" in answer, answer
    for wrong in (b"\r\n", b"x\r\n", b"5 \nhello", b"5\r\nhelloo\r\n0\r\n\r\n", b"123456789\r\n",
                  b"-5\r\nhello\r\n", b"1\r\na\r\n0\r\n\rb", b"1;" + b"e" * 5000 + b"\r\n", b"0\r\n\r\n"):
        answer = d.raw(head + wrong, 5)
        assert answer.startswith(b"HTTP/1.1 400"), (wrong[:20], answer)
    assert b"HTTP/1.1 413" in d.raw(
        b"POST /v1/models HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n20000\r\n" + b" " * 0x20000 + b"\r\n0\r\n\r\n", 5)
    d.wait_metric('relightd_resource_held{resource="payload"}', 0)


def bodies_that_end_early_or_drip(d):
    head = b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2000000\r\n\r\n"
    with socket.create_connection(("127.0.0.1", d.port)) as s:
        s.sendall(head + b"x" * 1500000)
        d.wait_metric('relightd_resource_held{resource="uploads"}', 1)
    d.wait_metric('relightd_resource_held{resource="uploads"}', 0)  # it left: nothing stays
    d.wait_metric('relightd_resource_held{resource="payload"}', 0)
    began = time.monotonic()
    with socket.create_connection(("127.0.0.1", d.port), timeout=20) as s:
        s.sendall(head + b"x" * 1500000)
        d.wait_metric('relightd_resource_held{resource="uploads"}', 1)
        try:
            while time.monotonic() < began + 60:
                s.sendall(b"x")
                time.sleep(0.1)
                s.settimeout(0.001)
                try:
                    if not s.recv(1000):
                        break
                except socket.timeout:
                    s.settimeout(20)
        except (BrokenPipeError, ConnectionResetError):
            pass
    assert time.monotonic() < began + 60, "a body may drip for ever (--frame-time)"
    d.wait_metric('relightd_resource_held{resource="uploads"}', 0)  # nobody can go on with it
    d.wait_metric('relightd_resource_held{resource="payload"}', 0)


def clients_that_leave_in_the_middle(d):
    """Their requests are cancelled, and nothing of them stays charged."""
    before = d.metrics()['relightd_requests_total{operation="image",outcome="gone"}'] \
        if 'relightd_requests_total{operation="image",outcome="gone"}' in d.metrics() else 0
    for i in range(20):
        with socket.create_connection(("127.0.0.1", d.port)) as s:
            s.sendall(b"GET /v1/models/small/image.exr?env=constant&size=4000x3900&samples=8&rotate=%d"
                      b" HTTP/1.1\r\nHost: localhost\r\n\r\n" % i)
            if i % 2:
                time.sleep(0.01 * i)
    for name in ("requests", "payload", "output", "connections"):
        d.wait_metric('relightd_resource_held{resource="%s"}' % name, 0, 60)
    assert d.metrics()['relightd_requests_total{operation="image",outcome="gone"}'] > before


def a_reader_that_stops_is_closed(d):
    with socket.create_connection(("127.0.0.1", d.port)) as s:
        s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        s.sendall(b"GET /v1/models/small/image?env=constant&size=3000x3000&format=f16 "
                  b"HTTP/1.1\r\nHost: localhost\r\n\r\n")
        d.wait_metric('relightd_resource_held{resource="requests"}', 0, 60)
        d.wait_metric('relightd_resource_held{resource="output"}', 0, 30)


def jobs_are_cancelled(d):
    loaded = json.loads(d.ask("POST", "/v1/models", OCTAHEDRON, query={
        "name": "long.obj", **SMALL, "samples": 200000, "seed": 7})[2])
    seen = []
    watcher = threading.Thread(
        target=lambda: seen.append(d.ask("GET", "/v1/jobs/%s/events" % loaded["job"])[2]))
    watcher.start()
    assert d.json("DELETE", "/v1/jobs/" + loaded["job"])["state"] in ("running", "queued", "cancelled")
    watcher.join(30)
    assert b"event: cancelled\n" in seen[0], seen
    d.problem(404, "DELETE", "/v1/jobs/job-999")
    d.problem(404, "GET", "/v1/jobs/job-999/events")


def too_much_at_once_is_refused(d):
    """429 with Retry-After where the client's own limit is reached, and then it is served."""
    held = [socket.create_connection(("127.0.0.1", d.port)) for _ in range(12)]
    try:
        for i, s in enumerate(held):
            s.sendall(b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1500000\r\n\r\n"
                      + b"x" * 1200000 + b"%d" % i)
        deadline = time.monotonic() + 20
        text = b""
        while b"HTTP/1.1 " not in text and time.monotonic() < deadline:
            for s in held:
                s.settimeout(0.05)
                try:
                    text += s.recv(4096)
                except (socket.timeout, ConnectionResetError):
                    pass
        assert b"HTTP/1.1 429" in text, text
        assert re.search(rb"retry-after: [1-9]", text.lower()), text  # whole seconds, never 0
    finally:
        for s in held:
            s.close()
    d.wait_metric('relightd_resource_held{resource="uploads"}', 0)
    d.json("POST", "/v1/blobs", b"served again", expect=201)


def chunked_bodies_beyond_a_limit(binaries):
    """413 where the client's memory can never hold the body, 429 where it holds others now."""
    d = Daemon(binaries, "--client-memory", "2000000")
    head = b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
    chunk = b"%x\r\n%s\r\n" % (600000, b"x" * 600000)
    try:
        answer = d.raw(head + 5 * chunk)
        assert answer.startswith(b"HTTP/1.1 413") and b'"code":"limit"' in answer, answer
        d.wait_metric('relightd_resource_held{resource="payload"}', 0)
        with socket.create_connection(("127.0.0.1", d.port), timeout=20) as s:
            s.sendall(head + chunk)
            d.wait_metric('relightd_resource_held{resource="payload"}', 1 << 20)
            answer = d.raw(head + chunk)
            assert answer.startswith(b"HTTP/1.1 429"), answer
            assert b"\r\nretry-after: 1\r\n" in answer, answer
            s.sendall(b"0\r\n\r\n")
            assert s.recv(4096).startswith(b"HTTP/1.1 20")
        d.wait_metric('relightd_resource_held{resource="payload"}', 0)
    finally:
        d.end()


def connections_beyond_a_limit(binaries):
    """429 where the client's own limit is reached, 503 where the daemon's is."""
    for option, status in (("--client-connections", 429), ("--connections", 503)):
        d = Daemon(binaries, option, "1")
        try:
            with socket.create_connection(("127.0.0.1", d.port)) as s:
                s.sendall(b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nx")
                d.wait_metric('relightd_resource_held{resource="connections"}', 1)
                problem, _ = d.problem(status, "GET", "/v1/models")
                assert option + ")" in problem["detail"], problem
                assert d.metrics()["relightd_connections_refused_total"] == 1
            d.wait_metric('relightd_resource_held{resource="connections"}', 0)
            d.json("GET", "/v1/models")
        finally:
            d.end()


def models_are_forgotten(d):
    assert d.json("DELETE", "/v1/models/small?forget=yes")["state"] == "unknown"
    d.problem(404, "GET", "/v1/models/small")
    for name in ("requests", "long_requests", "payload", "output", "connections", "uploads", "jobs"):
        d.wait_metric('relightd_resource_held{resource="%s"}' % name, 0)


def tokens_are_wanted(binaries):
    d = Daemon.__new__(Daemon)
    d.__init__(binaries, "--token-file", token_file())
    try:
        _, headers = d.problem(401, "GET", "/v1/models")
        assert headers["www-authenticate"].startswith("Bearer")
        d.problem(401, "GET", "/v1/nothing")
        d.problem(401, "GET", "/metrics")
        d.problem(401, "GET", "/v1/models", headers={"Authorization": "Bearer wrong"})
        d.problem(401, "POST", "/v1/blobs", b"x" * 100000, headers={"Authorization": "Basic x"})
        for scheme in ("Bearer ", "bearer ", "BEARER  "):  # RFC 9110 section 11.1: without regard to capitals
            assert d.ask("GET", "/v1/models", headers={"Authorization": scheme + "right"})[0] == 200
        for wrong in ("Bearer", "Bearerright", "right", "Basic right"):
            d.problem(401, "GET", "/v1/models", headers={"Authorization": wrong})
        for open_page in ("/healthz", "/readyz", "/v1/openapi.json"):
            assert d.ask("GET", open_page)[0] == 200
    finally:
        d.end()


def token_file():
    path = os.path.join(os.environ.get("TMPDIR", "/tmp"), "relight-http-token-%d" % os.getpid())
    with open(path, "w", encoding="utf-8") as f:
        f.write("right\n")
    os.chmod(path, 0o600)
    return path


def main():
    binaries = sys.argv[1]
    run([a_model_is_uploaded_and_baked, models_are_listed_and_described, pictures, colours, uploads,
         methods_and_request_ids, a_foreign_page_gets_nothing, attacks_on_the_first_part,
         chunked_bodies, bodies_that_end_early_or_drip, clients_that_leave_in_the_middle, a_reader_that_stops_is_closed,
         jobs_are_cancelled, too_much_at_once_is_refused, models_are_forgotten],
        lambda: Daemon(binaries, "--frame-time", "2", "--write-time", "2", "--max-blob", "5000000",
                       "--client-uploads", "8", "--log", "trace"))
    print("    chunked bodies beyond a limit")
    chunked_bodies_beyond_a_limit(binaries)
    print("    connections beyond a limit")
    connections_beyond_a_limit(binaries)
    print("    tokens are wanted")
    try:
        tokens_are_wanted(binaries)
    finally:
        os.unlink(token_file())


main()
