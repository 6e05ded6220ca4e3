#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The images of deploy/cluster: made without a registry, they are images of OCI with what Containerfile says; the
daemon runs in them as nobody's user on a read-only root without a capability, is found healthy by the image's own
check, bakes, draws, and ends by itself at SIGTERM.

   image.py BUILD_FOLDER [IMAGES]      IMAGES: a folder where deploy/cluster/image has left them"""
import hashlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time

BUILD = os.path.abspath(sys.argv[1])
IMAGE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../deploy/cluster/image")
CLOSURE_MB = 120  # relightd and every library that it loads
TOKEN = "a-token-of-the-test-0123456789abcdef"


def skip(why):
    print("skipped: %s (deploy/dependencies --images)" % why)
    sys.exit(77)


def run(*words, **more):
    done = subprocess.run(words, capture_output=True, text=True, check=False, **more)
    assert done.returncode == 0, "%s: %s" % (" ".join(words), done.stderr[-2000:])
    return done.stdout


def blob(layout, digest):
    kind, _, name = digest.partition(":")
    with open("%s/blobs/%s/%s" % (layout, kind, name), "rb") as f:
        data = f.read()
    assert hashlib.sha256(data).hexdigest() == name, "the bytes of %s" % digest
    return data


def look_at(layout):
    """Manifests and configurations of the layout, by name."""
    with open(layout + "/oci-layout", encoding="ascii") as f:
        assert json.load(f)["imageLayoutVersion"] == "1.0.0"
    with open(layout + "/index.json", encoding="ascii") as f:
        index = json.load(f)
    found = {}
    for entry in index["manifests"]:
        manifest = json.loads(blob(layout, entry["digest"]))
        for layer in manifest["layers"]:
            assert len(blob(layout, layer["digest"])) == layer["size"]
        config = json.loads(blob(layout, manifest["config"]["digest"]))
        name = entry["annotations"]["org.opencontainers.image.ref.name"]
        found[name] = (manifest, config)
        box = config["config"]
        assert box["User"] == "10001:10001" and box["StopSignal"] == "SIGTERM", box
        assert box["Entrypoint"][0] == "/usr/bin/relightd" and set(box["Volumes"]) == {"/var/lib/relight", "/srv/relight"}
    layers = [[layer["digest"] for layer in found[name][0]["layers"]] for name in ("relightd-server", "relightd")]
    assert layers[1][:len(layers[0])] == layers[0] and len(layers[1]) == len(layers[0]) + 1, "helpers are one layer more"
    return found


def health_of(archive, folder):
    """The health check of an archive for `docker load`; OCI's configuration has no place for one."""
    os.makedirs(folder)
    run("tar", "-xf", archive, "-C", folder, "--wildcards", "*.json")
    with open(folder + "/manifest.json", encoding="ascii") as f:
        config = json.load(f)[0]["Config"]
    with open(os.path.join(folder, config), encoding="ascii") as f:
        test = json.load(f)["config"]["Healthcheck"]["Test"]
    assert test[0] == "CMD", test
    return test[1:]


def closure(root):
    """Bytes of relightd and what it loads, of the image's own files."""
    loader = next(path for path in ("/lib64/ld-linux-x86-64.so.2", "/usr/lib/ld-linux-aarch64.so.1")
                  if os.path.exists(root + path))
    listed = run("chroot", root, loader, "--list", "/usr/bin/relightd", env={"PATH": os.environ["PATH"]})
    paths = {root + "/usr/bin/relightd", root + loader}
    for line in listed.splitlines():
        words = line.split()
        path = words[2] if "=>" in words else words[0]
        assert path != "not", "missing in the image: " + line
        if path.startswith("/"):
            paths.add(os.path.realpath(root + ("/usr" + path if path.startswith("/lib") else path)))
    paths = {os.path.realpath(path) for path in paths}
    return sum(os.path.getsize(p) for p in paths), len(paths)


def bundle(layout, name, folder, web, tcp):
    """Unpacks an image, and has its root read-only, the host's network, no capability."""
    run("umoci", "unpack", "--image", layout + ":" + name, folder)
    with open(folder + "/config.json", encoding="utf-8") as f:
        spec = json.load(f)
    assert spec["process"]["user"] == {"uid": 10001, "gid": 10001}
    for part in ("data", "shared"):
        os.makedirs("%s/%s" % (folder, part))
        os.chown("%s/%s" % (folder, part), 10001, 10001)
    os.makedirs(folder + "/secrets")
    with open(folder + "/secrets/relight-token", "w", encoding="ascii") as f:
        f.write(TOKEN + "\n")
    spec["root"]["readonly"] = True
    spec["process"].update(terminal=False, noNewPrivileges=True, capabilities={}, rlimits=[])
    spec["process"]["args"] = [w.replace("0.0.0.0:8080", "127.0.0.1:%d" % web).replace("0.0.0.0:7413", "127.0.0.1:%d" % tcp)
                               for w in spec["process"]["args"]] + ["--store", "/srv/relight", "--lame-duck", "0"]
    spec["mounts"] = [m for m in spec["mounts"] if m["destination"] in ("/proc", "/dev", "/dev/shm")]
    spec["mounts"] += [{"destination": "/tmp", "type": "tmpfs", "source": "tmpfs", "options": ["nosuid", "nodev"]},
                       {"destination": "/run", "type": "tmpfs", "source": "tmpfs", "options": ["nosuid", "nodev"]}]
    for there, here, how in (("/var/lib/relight", "data", "rw"), ("/srv/relight", "shared", "rw"),
                             ("/run/secrets", "secrets", "ro")):
        spec["mounts"].append({"destination": there, "type": "bind", "source": "%s/%s" % (folder, here),
                               "options": ["bind", how]})
    spec["linux"]["namespaces"] = [{"type": t} for t in ("pid", "ipc", "uts", "mount")]
    for key in ("resources", "cgroupsPath"):
        spec["linux"].pop(key, None)
    with open(folder + "/config.json", "w", encoding="utf-8") as f:
        json.dump(spec, f)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def octahedron(path):
    with open(path, "w", encoding="ascii") as f:
        f.write("v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n"
                "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n")


def live(layout, name, folder, health, pictures):
    web, tcp = free_port(), free_port()
    bundle(layout, name, folder, web, tcp)
    box = "relight-test-%d-%s" % (os.getpid(), name)
    runc = ["runc", "--root", folder + "/runc"]
    with open(folder + "/log", "wb") as log:
        process = subprocess.Popen([*runc, "run", "--bundle", folder, box], stdout=log, stderr=log)

    def inside(*words):
        return subprocess.run([*runc, "exec", box, *words], capture_output=True, text=True, check=False)

    def client(*words):
        return run(BUILD + "/bin/relight", "-s", "tcp:127.0.0.1:%d" % tcp, *words,
                   env=dict(os.environ, RELIGHT_TOKEN=TOKEN))
    try:
        test = [w.replace("127.0.0.1:8080", "127.0.0.1:%d" % web) for w in health]
        while inside(*test).returncode:
            assert process.poll() is None, "it does not start: " + open(folder + "/log", encoding="utf-8").read()[-3000:]
            time.sleep(0.1)
        assert inside("/bin/busybox", "id", "-u").stdout.strip() == "10001"
        assert "Read-only" in inside("/bin/busybox", "touch", "/usr/bin/x").stderr
        status = inside("/bin/busybox", "grep", "-E", "CapEff|NoNewPrivs", "/proc/1/status").stdout.split()
        assert status[1] == "0" * 16 and status[3] == "1", status
        octahedron(folder + "/ball.obj")
        client("load", folder + "/ball.obj", "--size-mm", "20", "--material", "marble", "--transport", "wavelet",
               "--samples", "1000", "--cube", "16", "--wait")
        client("colors", "ball", "--env", "constant", "-o", folder + "/ball.ply")
        if pictures:
            client("image", "ball", "--env", "constant", "--size", "64x48", "-o", folder + "/ball.png")
            with open(folder + "/ball.png", "rb") as f:
                assert f.read(4) == b"\x89PNG"
        assert os.listdir(folder + "/shared/bakes"), "no bake in the shared folder"
        subprocess.run([*runc, "kill", box, "TERM"], check=True)
        assert process.wait(60) == 0, open(folder + "/log", encoding="utf-8").read()[-3000:]
        print("%s: healthy, baked%s, ended by itself" % (name, " and drew" if pictures else ""))
    finally:
        if process.poll() is None:
            subprocess.run([*runc, "delete", "-f", box], check=False)
            process.wait()


def main():
    for program in ("buildah", "umoci", "runc"):
        if not shutil.which(program):
            skip("no " + program)
    if not os.path.exists("/bin/busybox"):
        skip("no busybox-static")
    if os.geteuid():
        skip("not root")
    folder = tempfile.mkdtemp(prefix="relight-image-", dir="/var/tmp")
    try:
        out = sys.argv[2] if len(sys.argv) > 2 else folder + "/out"
        if out == folder + "/out":
            print(run(IMAGE, BUILD, out).strip())
        layout = out + "/oci"
        look_at(layout)
        health = health_of(out + "/relightd.tar", folder + "/json")
        live(layout, "relightd-server", folder + "/server", health, False)
        size, n = closure(folder + "/server/rootfs")
        print("relightd and its %d libraries: %.1f MB (at most %d)" % (n - 1, size / 1e6, CLOSURE_MB))
        assert size <= CLOSURE_MB * 1e6
        live(layout, "relightd", folder + "/full", health, True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


main()
