# SPDX-License-Identifier: MIT
"""Replicas of relightd on one folder, for the tests of them; argv[1], argv[2] are the folders of the programs and of
the Python package. A test that imports this file is skipped where numpy or protobuf is missing."""
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time

try:
    import google.protobuf  # noqa: F401
    import numpy  # noqa: F401
except ImportError as missing:
    print("skipped: %s; deploy/dependencies --tests installs it" % missing)
    sys.exit(77)

from web import OCTAHEDRON, no_reports

sys.path.insert(0, sys.argv[2])
import relight  # noqa: E402

# A bake of a second.
BAKE = {"samples": 200, "cube": 16, "single_points": 2, "transport": "wavelet", "material": "marble"}


def shared_folder(folder, number):
    """The folder of --store. RELIGHT_TEST_MOUNTS="DIR DIR": it lies in a folder that each of two machines mounts."""
    mounts = os.environ.get("RELIGHT_TEST_MOUNTS", "").split()
    return "%s/%s" % (mounts[number % len(mounts)], os.path.basename(folder)) if mounts else folder + "/shared"


class Replica:
    def __init__(self, folder, number, programs=sys.argv[1], more=(), env=None):
        self.programs, self.more, self.env = programs, more, env
        self.address = "unix:%s/s%d" % (folder, number)
        self.folder, self.number, self.client = folder, number, None
        self.start()

    def start(self):
        path = self.address[5:]
        if os.path.exists(path):
            os.unlink(path)
        self.process = self.start_process(self.programs, self.folder, self.number,
                                          shared_folder(self.folder, self.number),
                                          self.more, self.env)
        end = time.monotonic() + 60
        while not os.path.exists(path):
            if time.monotonic() > end or self.process.poll() is not None:
                self.process.kill()
                self.process.wait()
                raise AssertionError("it does not start:\n" + self.log()[-6000:])
            time.sleep(0.01)

    @staticmethod
    def start_process(programs, folder, number, shared, more=(), env=None):
        with open("%s/log%d" % (folder, number), "ab") as log:
            return subprocess.Popen(
                [programs + "/relightd", "--data", "%s/data%d" % (folder, number), "--store", shared,
                 "--listen", "unix:%s/s%d" % (folder, number), "--store-poll", "0.5", *more], stderr=log, env=env)

    def log(self):
        with open("%s/log%d" % (self.folder, self.number), encoding="utf-8", errors="replace") as f:
            return f.read()

    def ask(self):
        if not self.client:
            self.client = relight.Client(self.address)
        return self.client

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.client = None

    def stop(self):
        self.process.terminate()
        assert self.process.wait(30) == 0


@contextlib.contextmanager
def replicas_in_a_folder(name):
    """A folder and the list of the test's replicas, which the caller fills. At the end they stop; after an exception
    their logs are printed and they are killed. The folder is removed."""
    folder = tempfile.mkdtemp(prefix="relightd-%s-" % name)
    replicas = []
    try:
        yield folder, replicas
        for r in replicas:
            r.stop()
            no_reports(r.log())
    except BaseException:
        for r in replicas:
            print("---- replica %d\n%s" % (r.number, r.log()[-6000:]))
        raise
    finally:
        for r in replicas:
            if r.process.poll() is None:
                r.process.kill()
                r.process.wait()
        shutil.rmtree(folder, ignore_errors=True)


def model_file(folder, scale):
    """An octahedron of another size: another model."""
    path = "%s/ball-%g.obj" % (folder, scale)
    with open(path, "wb") as f:
        f.write(OCTAHEDRON + b"# %g\n" % scale)
    return path


def until(what, seconds, call):
    end = time.monotonic() + seconds
    while True:
        try:
            got = call()
            if got is not None and got is not False:
                return got
        except relight.RelightError as error:
            last = str(error)
        else:
            last = "not yet"
        assert time.monotonic() < end, "%s: %s" % (what, last)
        time.sleep(0.05)
