#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""proto/openapi.json against a live relightd: each path and method is called, each answer must be one
that the document has, with its type, headers and schema, and each documented status must come, but
for those in UNSEEN.  openapi.py BIN OPENAPI.JSON"""
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time

try:
    import jsonschema
    VALIDATOR = jsonschema.Draft202012Validator
except (ImportError, AttributeError):
    print("skipped: this needs python3-jsonschema 4 or newer (deploy/dependencies --tests)")
    sys.exit(77)

from web import Daemon, OCTAHEDRON, SMALL, sky

# A fault of the daemon, limits of a client and deadlines are reached where the table below does it.
UNSEEN = {"500", "429", "504"}
# Answered while the daemon drains, too; 503 comes when it is full.
RARE = {("/v1/jobs/{job}", "DELETE", "503")}
OPTIONAL_HEADERS = {"X-Relight-Note", "Link", "Cache-Control"}
OPEN = {"/healthz", "/readyz", "/v1/openapi.json"}
JSON = {"Content-Type": "application/json"}


class Document:
    def __init__(self, text):
        self.doc = json.loads(text)
        self.seen = set()
        assert self.doc["openapi"].startswith("3.1")
        for name, schema in self.doc["components"]["schemas"].items():
            VALIDATOR.check_schema(schema)
            assert schema.get("type") == "object" or "enum" in schema, name
        ids = [op["operationId"] for _, _, op in self.operations()]
        assert len(ids) == len(set(ids))
        for ref in re.findall(r'"\$ref": ?"#/([^"]+)"', text):
            self.at(ref)

    def at(self, path):
        node = self.doc
        for word in path.split("/"):
            node = node[word]
        return node

    def follow(self, node):
        return self.at(node["$ref"][2:]) if "$ref" in node else node

    def operations(self):
        return [(path, method.upper(), op) for path, methods in self.doc["paths"].items()
                for method, op in methods.items()]

    def check(self, path, method, status, headers, body):
        where = (path, method, status)
        responses = self.doc["paths"][path][method.lower()]["responses"]
        assert str(status) in responses, "%s: not in the document: %s" % (where, body[:300])
        self.seen.add((path, method, str(status)))
        if status == 403 and not headers.get("content-type", "").startswith("application/problem"):
            return  # Host and Origin are refused before the API
        response = self.follow(responses[str(status)])
        for name in response.get("headers", {}):
            assert name.lower() in headers or name in OPTIONAL_HEADERS, (where, name, headers)
            spec = self.follow(response["headers"][name])["schema"]
            value = headers.get(name.lower())
            if value is not None and spec["type"] in ("integer", "number"):
                float(value)
        content = response.get("content")
        if not content:
            assert not body, (where, body[:100])
            return
        kind = headers["content-type"].split(";")[0]
        if kind not in content and kind.startswith("image/"):
            kind = "image/*"
        assert kind in content, (where, kind)
        if kind.endswith("json"):
            schema = {**content[kind]["schema"], "components": self.doc["components"]}
            errors = list(VALIDATOR(schema).iter_errors(json.loads(body)))
            assert not errors, (where, errors[0].message, body[:500])
            self.no_more(content[kind]["schema"], json.loads(body), where)

    def no_more(self, schema, value, where):
        """Fields that the schema does not name are fields that the document has forgotten."""
        schema = self.follow(schema)
        if isinstance(value, list):
            for one in value:
                self.no_more(schema.get("items", {}), one, where)
        elif isinstance(value, dict) and "properties" in schema:
            for name, inner in value.items():
                assert name in schema["properties"], (where, "a field that is not documented", name)
                self.no_more(schema["properties"][name], inner, where)


ROOM = ["b"]


def concrete(path, model, job, name):
    room = "absent" if model == "absent" else ROOM[0]
    return path.format(model=model, job=job, hash=name, room=room, ending="png" if "image" in path else "csv",
                       environment="absent" if model == "absent" else "constant")


def call(document, d, path, method, target, body=None, headers=None, expect=None):
    status, got, answer = d.ask(method, target, body, headers)
    assert expect is None or status == expect, (method, target[:200], status, expect, answer[:300])
    document.check(path, method, status, got, answer)
    return got, answer


def rooms(go, d, model):
    """A room is made in a terminal; HTTP shows it."""
    relight = [d.binaries + "/relight", "-s", "unix:" + d.folder + "/s", "room"]
    run = lambda *words: subprocess.run(relight + list(words), check=True, capture_output=True, text=True).stdout
    ROOM[0] = run("create", "a room", "--model", model, "--env", "constant", "--size", "16x12").strip()
    run("pin", "a room", "here", "--at", "0,1,0.2,0.2")
    room = "/v1/rooms/" + ROOM[0]
    listed = json.loads(go("/v1/rooms", "GET", "/v1/rooms", expect=200)[1])["rooms"]
    assert [one["name"] for one in listed] == ["a room"], listed
    state = json.loads(go("/v1/rooms/{room}", "GET", room, expect=200)[1])
    assert state["pins"][0]["notes"][0]["text"] == "here", state
    events = json.loads(go("/v1/rooms/{room}/events", "GET", room + "/events?after=1", expect=200)[1])["events"]
    assert [one["stamp"]["sequence"] for one in events] == [2], events
    picture = "/v1/rooms/{room}/image.{ending}"
    pin, now = room + "/image.png?pin=2", room + "/image.png?size=20x10"
    tag = go(picture, "GET", pin, expect=200)[0]["etag"]
    go(picture, "GET", pin, None, {"If-None-Match": tag}, 304)
    assert go(picture, "GET", now, expect=200)[0]["x-relight-size"] == "20x10"
    for bad in ("image.jpg", "image.png?pin=77"):
        go(picture, "GET", room + "/" + bad, expect=404)
    for item in ("pin", "decision", "revision"): # none has the number 0, which is no word for the scene
        error = json.loads(go(picture, "GET", room + "/image.png?%s=0" % item, expect=400)[1])
        assert error["parameter"] == item, error


def successes(document, d):
    """Every 2xx and 304; the model, its job, and a blob."""
    go = lambda *args, **kwargs: call(document, d, *args, **kwargs)
    for path in ("/healthz", "/readyz", "/metrics"):
        go(path, "GET", path, expect=200)
    tag = go("/v1/openapi.json", "GET", "/v1/openapi.json", expect=200)[0]["etag"]
    go("/v1/openapi.json", "GET", "/v1/openapi.json", None, {"If-None-Match": tag}, 304)
    load = "/v1/models?name=small.obj&" + "&".join("%s=%s" % item for item in SMALL.items())
    loaded = json.loads(go("/v1/models", "POST", load, OCTAHEDRON, None, 202)[1])
    model, job = loaded["model"], loaded["job"]
    go("/v1/jobs/{job}", "GET", "/v1/jobs/" + job, expect=200)
    go("/v1/jobs/{job}/events", "GET", "/v1/jobs/%s/events" % job, expect=200)
    go("/v1/jobs/{job}/events", "GET", "/v1/jobs/%s/events" % job, None, {"Last-Event-ID": "1"}, 204)
    go("/v1/jobs/{job}", "DELETE", "/v1/jobs/" + job, expect=200)
    go("/v1/models", "POST", load, OCTAHEDRON, None, 200)
    go("/v1/models", "GET", "/v1/models", expect=200)
    go("/v1/models/{model}", "GET", "/v1/models/" + model, expect=200)
    rooms(go, d, model)
    name = json.loads(go("/v1/blobs", "POST", "/v1/blobs?name=sky.hdr", sky(), None, 201)[1])["hash"]
    go("/v1/blobs/{hash}", "GET", "/v1/blobs/" + name, expect=200)
    listed = json.loads(go("/v1/models", "GET", "/v1/models", expect=200)[1])["environments"]
    assert [one["env"] for one in listed] == ["env:" + name], listed
    go("/v1/blobs/{hash}", "PUT", "/v1/blobs/" + name, sky(), None, 201)
    go("/v1/blobs/{hash}", "PUT", "/v1/blobs/%s?size=10" % ("1" * 64), b"12345", None, 202)
    thumbnail = "/v1/environments/{environment}/image.jpg"
    tag = go(thumbnail, "GET", "/v1/environments/sky/image.jpg", expect=200)[0]["etag"]
    go(thumbnail, "GET", "/v1/environments/sky/image.jpg?width=256", None, {"If-None-Match": tag}, 304)
    broken = json.loads(go("/v1/blobs", "POST", "/v1/blobs?name=broken.hdr", b"no image", None, 201)[1])["hash"]
    go(thumbnail, "GET", "/v1/environments/%s/image.jpg" % broken, expect=422)
    for kind in ("image", "colors"):
        for ending in ("", ".{ending}"):
            path = "/v1/models/{model}/%s%s" % (kind, ending)
            end = "" if not ending else ".png" if kind == "image" else ".f32"
            size = "&size=16x12" if kind == "image" else ""
            base = "/v1/models/%s/%s%s" % (model, kind, end)
            tag = go(path, "GET", "%s?env=constant%s" % (base, size), expect=200)[0]["etag"]
            again = {"If-None-Match": tag}
            go(path, "GET", "%s?env=constant%s" % (base, size), None, again, 304)
            go(path, "POST", "%s?rotate=5%s" % (base, size), sky(), None, 200)
            light = json.dumps({"lights": [{"env": "constant"}]})
            go(path, "POST", "%s?%s" % (base, size[1:]), light, {**JSON, **again}, 304)
    return model, job, name


def faults(document, d, model, job, name):
    go = lambda *args, **kwargs: call(document, d, *args, **kwargs)
    preview = json.loads(d.ask("POST", "/v1/models?name=draft.obj&size_mm=10&material=marble&preview=yes",
                               OCTAHEDRON.replace(b"v 1 ", b"v 2 "))[2])["model"]
    for path, method, op in document.operations():
        target = concrete(path, model, job, name)
        body = sky() if method in ("POST", "PUT") else None
        wants = op["responses"]
        lit = "/v1/models/{model}/" in path
        query = "?env=constant&" if method == "GET" and lit else "?"
        go(path, method, target + query + "unknown=1", body, None, 400)
        go(path, method, target, body, {"Origin": "http://evil.example"}, 403)
        wrong = d.ask("PATCH", target)
        document.check(path, method, wrong[0], wrong[1], wrong[2])
        assert wrong[0] == 405
        if "404" in wants and path not in OPEN:
            absent = concrete(path, "absent", "absent", "2" * 64)
            if path == "/v1/models":
                files = {"files": [{"name": "a.obj", "blob": "2" * 64}], "size_mm": 1}
                go(path, method, path, json.dumps(files), JSON, 404)
            elif path == "/v1/blobs/{hash}" and method == "PUT":
                go(path, method, "/v1/blobs/nonsense", body, None, 404)
            else:
                go(path, method, absent + query, body, None, 404)
        if "415" in wants:
            named = target + ("?name=a.obj" if path == "/v1/models" else "")
            go(path, method, named, body, {"Content-Type": "multipart/form-data; boundary=x"}, 415)
        if "501" in wants:
            raw = d.raw(("%s %s HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: gzip\r\n\r\n"
                         "0\r\n\r\n" % (method, target)).encode(), 3)
            head, _, rest = raw.partition(b"\r\n\r\n")
            lines = head.decode().split("\r\n")
            headers = {k.lower(): v for k, v in (line.split(": ", 1) for line in lines[1:])}
            document.check(path, method, int(lines[0].split()[1]), headers, rest)
        if "413" in wants and method in ("POST", "PUT"):
            go(path, method, target + ("?name=a.obj" if path == "/v1/models" else ""), b"x" * 2000001,
               None, 413)
        if "422" in wants and method in ("POST", "PUT"):
            bad = target + ("?name=a.glb&preview=yes&size_mm=1" if path == "/v1/models" else "")
            if path == "/v1/blobs/{hash}":
                bad = "/v1/blobs/" + "3" * 64
            if path != "/v1/blobs":
                go(path, method, bad, b"no file of ours", None, 422)
        if "409" in wants:
            engine = "engine=wavelet" if "image" in path else ""
            go(path, method, concrete(path, preview, job, name) + query + engine, body, None, 409)
        if "422" in wants and method == "GET" and lit:  # the bake has a material of its own
            go(path, method, target + query + "material=skin1", None, None, 422)
    # A deadline that passes, and a model that goes.
    big = "/v1/models/%s/image.exr?env=constant:3,2,1&size=2000x1900&samples=8&deadline_ms=1" % model
    go("/v1/models/{model}/image.{ending}", "GET", big, expect=504)
    go("/v1/models/{model}", "DELETE", "/v1/models/%s?forget=yes&force=yes" % model, expect=200)


def tokens(document, binaries):
    handle, path = tempfile.mkstemp()
    os.write(handle, b"right\n")
    os.close(handle)
    d = Daemon(binaries, "--token-file", path)
    try:
        for template, method, op in document.operations():
            if "401" in op["responses"]:
                body = b"x" if method in ("POST", "PUT") else None
                call(document, d, template, method, concrete(template, "a", "b", "4" * 64), body, None, 401)
            else:
                assert template in OPEN, template
    finally:
        d.end()
        os.unlink(path)


def leaving(document, binaries):
    """What a daemon answers while it drains: a reader that stops keeps it from leaving."""
    d = Daemon(binaries, "--drain", "30", "--write-time", "30")
    try:
        model = d.bake()
        with socket.create_connection(("127.0.0.1", d.port)) as slow:
            slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            slow.sendall(b"GET /v1/models/%s/image?env=constant&size=2500x2500&format=f16 HTTP/1.1\r\n"
                         b"Host: localhost\r\n\r\n" % model.encode())
            end = time.monotonic() + 120
            while not d.metrics().get('relightd_requests_total{operation="image",outcome="ok"}'):
                assert time.monotonic() < end
                time.sleep(0.1)
            d.process.terminate()
            d.wait_log("drain requests=")
            call(document, d, "/readyz", "GET", "/readyz", expect=404)
            for template, method, op in document.operations():
                if "503" not in op["responses"] or template == "/readyz" or "jobs" in template and method == "DELETE":
                    continue
                body = None
                target = concrete(template, model, model, "5" * 64)
                if method in ("POST", "PUT"):
                    body = b"x"
                    target += "?name=a.obj" if template == "/v1/models" else ""
                elif "/v1/models/{model}/" in template:
                    target += "?env=constant"
                call(document, d, template, method, target, body, None, 503)
    finally:
        d.end()


def unready(document, binaries):
    d = Daemon(binaries)
    work = d.folder + "/data/work"
    try:
        os.rename(work, work + ".away")
        end = time.monotonic() + 20
        while d.ask("GET", "/readyz")[0] != 503:
            assert time.monotonic() < end
            time.sleep(0.2)
        call(document, d, "/readyz", "GET", "/readyz", expect=503)
    finally:
        os.rename(work + ".away", work)
        d.end()


def main():
    binaries = sys.argv[1]
    with open(sys.argv[2], encoding="utf-8") as f:
        text = f.read()
    document = Document(text)
    d = Daemon(binaries, "--max-blob", "2000000")
    try:
        assert d.ask("GET", "/v1/openapi.json")[2].decode() == text, "another document is served"
        faults(document, d, *successes(document, d))
    except BaseException:
        print(d.log()[-3000:])
        raise
    finally:
        d.end()
    tokens(document, binaries)
    unready(document, binaries)
    leaving(document, binaries)
    missing = [(p, m, s) for p, m, op in document.operations() for s in op["responses"]
               if (p, m, s) not in document.seen]
    never = [x for x in missing if x[2] not in UNSEEN and x not in RARE]
    for one in never:
        print("    documented and not seen: %s %s %s" % (one[1], one[0], one[2]))
    all_seen = {s for _, _, s in document.seen}
    print("    %d operations, %d answers of theirs seen, statuses %s; not seen: %d" % (
        len(document.operations()), len(document.seen), " ".join(sorted(all_seen)), len(missing)))
    assert not never, "%d answers are documented and never came" % len(never)


main()
