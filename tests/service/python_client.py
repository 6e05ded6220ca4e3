#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""client/python against a live relightd: uploads with progress, bakes, colours in every format,
pictures, edits, views, links, errors.

   python_client.py FOLDER_OF_THE_PROGRAMS FOLDER_OF_THE_PACKAGE"""
import os
import socket
import struct
import subprocess
import sys

try:
    import google.protobuf  # noqa: F401
    import numpy as np
except ImportError as missing:
    print("skipped: %s; deploy/dependencies --tests installs it" % missing)
    sys.exit(77)

from web import OCTAHEDRON, Daemon, sky

sys.path.insert(0, sys.argv[2])
import relight  # noqa: E402
from relight.connection import ANSWER, FIXED, LAST, TYPES, Connection  # noqa: E402
from relight.messages import enum, message  # noqa: E402

BAKE = {"samples": 300, "cube": 16, "single_points": 2}


def rmse(got, want):
    return float(np.sqrt(((got - want) ** 2).sum() / (want ** 2).sum()))


def fails(code, call, *arguments, **options):
    try:
        call(*arguments, **options)
    except relight.RelightError as error:
        assert error.code == code, (error.code, code, str(error))
        return error
    raise AssertionError("%s was expected" % code)


def uploads_and_bakes(c, folder):
    seen = []
    with open(folder + "/noise.bin", "wb") as f:
        f.write(os.urandom(5 << 20))
    named = c.upload(folder + "/noise.bin", progress=lambda p: seen.append(p.fraction))
    assert len(named) == 64 and seen == sorted(seen) and seen[-1] == 1 and len(seen) > 3, seen
    seen.clear()
    assert c.upload(folder + "/noise.bin", progress=lambda p: seen.append(p.fraction)) == named
    assert seen == [1.0]
    fails("CANCELLED", c.upload, os.urandom(3 << 20), progress=lambda p: p.fraction > 0.2)
    with open(folder + "/ball.obj", "wb") as f:
        f.write(OCTAHEDRON)
    stages = []
    model = c.load(folder + "/ball.obj", size_mm=10, material="marble", name="ball",
                   progress=lambda p: stages.append(p.stage), transport="wavelet", **BAKE)
    assert c.info(model).state == "ready" and c.info("ball").id == model and "upload" in stages
    free = c.load(folder + "/ball.obj", size_mm=10, name="free", **BAKE)
    assert {m.name for m in c.models()} >= {"ball", "free"}
    assert c.info("free").engine == "joint"  # it is open now: the daemon reads a bake's head later
    all_models, call = c.models(), c._call

    def one_at_a_time(kind, request, payload=b""):
        request.limit = 1
        return call(kind, request, payload)

    c._call = one_at_a_time
    single = c.models()
    assert len(all_models) > 1 and single == all_models, (single, all_models)
    c._call = call
    assert c.info("ball").material["name"] == "marble"
    return model, free


def colours(c, model, folder):
    with open(folder + "/studio.hdr", "wb") as f:
        f.write(sky(pixel=(128, 64, 32, 129)))
    white = c.colors(model, "constant")
    assert white.shape == (6, 3) and white.dtype == np.float32 and (white > 0).all()
    subprocess.run([sys.argv[1] + "/relight", "colors", "ball", "--env", "constant", "-o", folder + "/ball.csv"],
                   env=dict(os.environ, RELIGHT_SERVER="unix:" + folder + "/s"), check=True,
                   stdout=subprocess.DEVNULL)
    with open(folder + "/ball.csv", encoding="ascii") as f:
        csv = f.read()
    want = np.array([list(map(float, line.split(",")[1:])) for line in csv.splitlines()[1:]], np.float32)
    assert np.array_equal(white, want)
    assert np.allclose(c.colors(model, "constant:2,2,2"), 2 * white, rtol=1e-4)
    assert np.allclose(c.colors(model, "constant", gain=[1, 0, 0])[:, 1:], 0)
    # A file is uploaded, and has a name from then on; an array is a light, too.
    studio = c.colors(model, folder + "/studio.hdr", rotate=30)
    assert np.array_equal(c.colors(model, "studio", rotate=30), studio)
    fails("NOT_FOUND", c.colors, model, "studi")
    assert [e.name for e in c.environments()] == ["studio.hdr"]
    cube = np.ones((6, 16, 16, 3), np.float32)
    cube[0] *= 9
    lit = c.colors(model, cube)
    both = c.colors(model, ["constant", cube], sum=False)
    assert both.shape == (2, 6, 3) and np.allclose(both[1], lit, rtol=1e-3) and lit.std() > white.std()
    assert np.allclose(c.colors(model, ["constant", cube]), both.sum(0), rtol=1e-3)
    for format, most in (("f16", 1e-3), ("rgb9e5", 4e-3), ("coefficients", 2e-3),
                         ("coefficients_packed", 3e-3)):
        assert rmse(c.colors(model, cube, format=format), lit) < most, format
    turned = c.colors(model, [cube, cube], rotate=[0, 90], sum=False)
    assert rmse(turned[0], lit) < 1e-3 and rmse(turned[1], c.colors(model, cube, rotate=90)) < 1e-3 < rmse(*turned)
    dim = c.colors(model, cube, gain=0.1)
    assert rmse(c.colors(model, cube, gain=0.1, format="srgb8"), dim) < 0.02
    planes = c.colors(model, ["constant", cube], sum=False, format="coefficients")
    assert rmse(planes, both) < 2e-3
    parts = c.colors(model, cube, term="multiple", format="coefficients")
    assert rmse(parts, c.colors(model, cube, term="multiple")) < 2e-3


def pictures_and_shapes(c, model):
    png = c.image(model, "constant", size=(40, 30), orbit=(30, 10))
    assert png.data[:4] == b"\x89PNG" and struct.unpack(">II", png.data[16:24]) == (40, 30)
    exact = c.image(model, "constant", size=(40, 30), format="f16", orbit=(30, 10))
    assert exact.pixels.shape == (30, 40, 3) and exact.engine == "wavelet"
    assert c.image(model, "constant", size=(8, 8), format="rgb8", background=(1, 0, 0)).pixels[0, 0, 0] > 100
    # From outside: the model in the middle, its background in the corners.
    seen = c.image(model, "constant", size=(9, 9), format="rgb8", background=(1, 0, 0), eye=(0, 0, 9),
                   target=(0, 0, 0), fovy=40).pixels
    assert seen[0, 0, 1] == 0 < seen[4, 4, 1], seen[:, :, 1]
    g = c.geometry("ball", own_units=True)
    assert g.positions.shape == (6, 3) and g.triangles.shape == (8, 3) and g.triangles.max() == 5
    assert np.allclose(np.abs(g.positions).sum(1), 1, atol=1e-5)
    assert np.allclose(np.linalg.norm(g.normals, axis=1), 1, atol=1e-4)


def edits(c, free):
    milk = {"sigma_s_prime": [2, 2, 3], "sigma_a": [0.01, 0.02, 0.05], "eta": 1.3}
    a, b = c.edit(free, "skin1", "constant"), c.edit(free, milk, "constant")
    assert rmse(a, b) > 0.05
    assert rmse(c.edit(free, milk, "constant", format="coefficients"), b) < 2e-3


def another_bake(c, folder):
    """Coefficients by a name are of the model that has it now, with factors of its own."""
    for material in ("cream", "skin1"):
        model = c.load(folder + "/ball.obj", size_mm=10, material=material, name="again", transport="wavelet", **BAKE)
        assert rmse(c.colors("again", "constant", format="coefficients"), c.colors("again", "constant")) < 2e-3
        c.unload(model, forget=True)


def views(c, model):
    cube = np.ones((6, 16, 16, 3), np.float32)
    cube[4] *= 20
    with c.view(model, cube, format="coefficients") as view:
        first = view.next(20)
        assert rmse(first.colors, c.colors(model, cube)) < 2e-3
        for angle in range(0, 100, 10):
            number = view.set(rotate=angle)
        for frame in view:
            if frame.sequence == number:
                break
        assert rmse(frame.colors, c.colors(model, cube, rotate=90)) < 2e-3
        try:
            view.next(0.2)
            raise AssertionError("a frame without a change")
        except TimeoutError:
            pass
        assert c.ping() < 10  # the connection is usable behind it
    with c.view(model, "constant", colors=False, size=(32, 32)) as view:
        assert view.next(20).image.data[:2] == b"\xff\xd8"
        pictures = []
        for zoom in (1, 4, 1):
            number = view.set(orbit=(20, 10, zoom))
            for frame in view:
                if frame.sequence == number:
                    break
            pictures.append(frame.image.data)
        assert pictures[0] == pictures[2] != pictures[1], "an orbit without its zoom"
    assert not view.open
    fails("CANCELLED", view.next, 1)


def addresses():
    """As librelight reads them: a host of IPv6 is in brackets, a port has 16 bits."""
    for wrong in ("", "tcp:", "tls:", "unix:", "http://localhost", "tcp:::1", "tcp:::1:7413", "tcp:[::1",
                  "tcp:[::1]7413", "tcp:[]:1", "tcp::7413", "tcp:localhost:", "tcp:localhost:65536",
                  "tcp:localhost:123456", "tcp:localhost:-1", "tcp:localhost:x",
                  "tcp:" + 70 * "a"):
        fails("ARGUMENT", relight.connection.connect, wrong, None, 5)
    assert "tcp:[::1]" in fails("ARGUMENT", relight.Client, "tcp:::1").hint
    fails("UNREACHABLE", relight.Client, "tcp:127.0.0.1:1")
    for family, host, written in ((socket.AF_INET, "127.0.0.1", "127.0.0.1"), (socket.AF_INET6, "::1", "[::1]")):
        with socket.socket(family) as listener:
            try:
                listener.bind((host, 0))
            except OSError:
                continue  # a machine without IPv6
            listener.listen()
            port = listener.getsockname()[1]
            relight.connection.connect("tcp:%s:%d" % (written, port), None, 5).close()


def a_frame_in_two_pieces(folder):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(folder + "/pieces")
        listener.listen()
        c = Connection("unix:" + folder + "/pieces", None, 5)
        daemon, _ = listener.accept()
        number = c.send("PING", message("PingRequest"))
        frame = FIXED.pack(b"RLGT", 1, LAST, TYPES["PING"][0] | ANSWER, number, 0, 0, 0)
        daemon.sendall(frame[:10])
        try:
            c.next(number, 0.05)
            raise AssertionError("a part of a frame")
        except TimeoutError:
            daemon.sendall(frame[10:])
        assert c.next(number, 5).last
        c.close()
        daemon.close()


def a_busy_daemon():
    """The wait is in milliseconds in the protocol (ERROR) and in seconds in this client."""
    def told(**fields):
        busy = message("Error", code=enum("ErrorCode", "ERROR_", "busy"), text="12 requests wait", **fields)
        return relight.RelightError.of_message(busy)
    assert told(retry_after_ms=1500).code == "BUSY" and told(retry_after_ms=1500).retry_after == 1.5
    assert told().retry_after is None


def a_view_that_fails(c, model):
    """The error of the daemon reaches the caller, and not one about the end of the view."""
    def follow():
        with c.view("nobody", "constant") as view:
            view.next(20)
    assert "nobody" in str(fails("NOT_FOUND", follow))


def links_and_errors(c, d, model):
    secret = subprocess.run([sys.argv[1] + "/relight", "token", "create", "--name", "py", "--scope",
                             "view"], env=dict(os.environ, RELIGHT_SERVER="unix:" + d.folder + "/s"),
                            capture_output=True, text=True, check=True).stdout.strip()
    with relight.Client("unix:" + d.folder + "/s", token=secret, timeout=20) as other:
        assert other.server.principal == "token:py" and other.server.scopes == ("view",)
        link = other.sign("/v1/models/ball/image.png?env=constant&size=16x16", lifetime=60)
        assert d.ask("GET", link.url)[2][:4] == b"\x89PNG"
        fails("FORBIDDEN", other.load, d.folder + "/ball.obj", size_mm=10)
    fails("FORBIDDEN", c.sign, "/v1/models/ball/image.png")
    assert fails("NOT_FOUND", c.info, "nobody").hint
    wrong = fails("OUT_OF_RANGE", c.colors, model, "constant", gain=-1)
    assert wrong.parameter == "lights[0].gain" and wrong.minimum == 0
    fails("MISMATCH", c.colors, model, "constant", material="skin1")
    fails("NOT_FOUND", c.colors, model, "nowhere")
    fails("ARGUMENT", c.colors, model, np.ones((6, 16, 3), np.float32))
    fails("UNREACHABLE", relight.Client, "unix:/nonexistent")
    assert "single" in str(fails("ARGUMENT", c.colors, model, "constant", term="half"))
    for wrong in ({"samplez": 1}, {"samples": "many"}, {"samples": -1}, {"transport": "bus"}):
        fails("ARGUMENT", c.load, path="ball.obj", **wrong)
    assert c.colors(model, "constant").shape == (6, 3)
    d.stop()
    fails("DISCONNECTED", c.ping)
    fails("DISCONNECTED", c.ping)


def main():
    addresses()
    a_busy_daemon()
    d = Daemon(sys.argv[1])
    try:
        with relight.Client("unix:" + d.folder + "/s", timeout=60) as c:
            model, free = uploads_and_bakes(c, d.folder)
            colours(c, model, d.folder)
            pictures_and_shapes(c, model)
            edits(c, free)
            another_bake(c, d.folder)
            views(c, model)
            a_frame_in_two_pieces(d.folder)
            a_view_that_fails(c, model)
            os.mkdir(d.folder + "/ball")  # a folder of the model's name is no file to upload
            example = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "client",
                                   "python", "examples", "turn_light.py")
            done = subprocess.run([sys.executable, example, "ball", "constant", "3"], cwd=d.folder,
                                  env=dict(os.environ, PYTHONPATH=os.path.abspath(sys.argv[2]),
                                           RELIGHT_SERVER="unix:" + d.folder + "/s"),
                                  capture_output=True, text=True, timeout=60)
            assert done.returncode == 0 and "6 vertices" in done.stdout, done
            assert np.load(d.folder + "/colors.npy").shape == (3, 6, 3)
            links_and_errors(c, d, model)
    finally:
        d.end()


main()
