#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Two relightd on one folder (--store): each serves what the other took, a bake goes on where its
replica died, and of random operations with SIGKILLs in between nothing acknowledged is lost.

   replicas.py FOLDER_OF_THE_PROGRAMS FOLDER_OF_THE_PACKAGE OPERATIONS"""
import concurrent.futures
import errno
import hashlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time

from replica import BAKE, Replica, model_file, relight, replicas_in_a_folder, shared_folder, until
from web import sky

import numpy as np


def each_serves_what_the_other_took(a, b, folder):
    studio = a.ask().upload(sky(pixel=(128, 64, 32, 129)), "studio.hdr")
    model = a.ask().load(model_file(folder, 1), size_mm=10, name="ball", **BAKE)
    want = a.ask().colors(model, "env:" + studio, rotate=30)
    assert np.array_equal(b.ask().colors("ball", "env:" + studio, rotate=30), want)
    assert b.ask().colors(model[:10], "constant").shape == (6, 3)
    # The same LOAD at the other needs no bake.
    assert b.ask().load(model_file(folder, 1), size_mm=10, name="ball", **BAKE) == model
    assert " started" not in b.log(), "the other bakes again"
    # Another name that it is loaded under at one is its name at the other.
    assert a.ask().load(model_file(folder, 1), size_mm=10, name="globe", **BAKE) == model
    until("renamed at the other", 20,
          lambda: [m.name for m in b.ask().models() if m.id == model] == ["globe"])
    # A model without a bake is read again; what one unloads goes everywhere.
    preview = b.ask().load(model_file(folder, 2), size_mm=10, name="glance", material="marble",
                           preview=True)
    until("listed at the other", 20, lambda: preview in [m.id for m in a.ask().models()])
    assert a.ask().image("glance", "constant", size=(64, 48), format="rgb8").pixels.shape[:2] == (48, 64)
    assert a.ask().info(preview).id == preview
    b.ask().unload(model, forget=True)
    until("unloaded at the other", 10,
          lambda: model not in [m.id for m in a.ask().models()])
    print("each serves what the other took")


def a_record_is_missing_for_a_moment(a, folder):
    """On NFS a record that another machine replaces can be missing when a replica looks: nobody unloaded the model."""
    c = Replica(folder, 3, more=("--store-poll", "60"))
    try:
        model = a.ask().load(model_file(folder, 5), size_mm=10, name="hidden", **BAKE)
        want = c.ask().colors("hidden", "constant")
        record = "%s/records/%s.json" % (shared_folder(folder, c.number), model)
        for there, then in ((record, record + ".aside"), (record + ".aside", record)):
            os.rename(there, then)
            try:
                c.ask().info("nobody")  # after a look at the folder
                raise AssertionError("a model that nobody loaded")
            except relight.RelightError as error:
                assert error.code == "NOT_FOUND", error
        assert np.array_equal(c.ask().colors("hidden", "constant"), want)
        assert "was unloaded by another" not in c.log()
        c.stop()
    finally:
        if c.process.poll() is None:
            c.process.kill()
            c.process.wait()


def a_record_that_is_too_long_hides_no_other(a, b, folder):
    record = "%s/records/%s.json" % (shared_folder(folder, a.number), "0" * 32)
    with open(record, "wb") as f:
        f.truncate(9 << 20)
    model = a.ask().load(model_file(folder, 6), size_mm=10, name="beside", **BAKE)
    until("listed at the other", 20, lambda: model in [m.id for m in b.ask().models()])
    os.unlink(record)
    a.ask().unload(model, forget=True)


def fifo_with_reader(path, seconds):
    """A descriptor to write to, once somebody reads."""
    def opened():
        try:
            return os.open(path, os.O_WRONLY | os.O_NONBLOCK)
        except OSError as error:
            assert error.errno == errno.ENXIO, error
            return None
    fd = until("the fetch has begun", seconds, opened)
    os.set_blocking(fd, True)
    return fd


def what_is_fetched_for_a_forgotten_model_goes(a, b, folder):
    """The shared bake becomes a FIFO, so that the fetch lasts until the test has written it."""
    model = a.ask().load(model_file(folder, 4), size_mm=10, name="leaving", **BAKE)
    shared = "%s/bakes/%s/%s.prt" % (shared_folder(folder, a.number), model[:2], model)
    here = "%s/data%d/bakes/%s.prt" % (folder, b.number, model)
    until("listed at the other", 20, lambda: model in [m.id for m in b.ask().models()])
    with open(shared, "rb") as f:
        bake = f.read()
    os.unlink(shared)
    os.mkfifo(shared)
    with concurrent.futures.ThreadPoolExecutor() as threads:
        asked = threads.submit(lambda: relight.Client(b.address).colors(model, "constant"))
        fd = fifo_with_reader(shared, 20)
        # The UNLOAD removes the model's file. Its removal must not come after the fetch.
        with open(here, "wb"):
            pass
        b.ask().unload(model, forget=True)
        until("its file is removed", 20, lambda: not os.path.exists(here))
        with open(fd, "wb") as f:
            f.write(bake)
        print("the model was forgotten during its fetch: %s" % (asked.exception() or asked.result().shape,))
    until("what was fetched is removed", 20, lambda: not os.path.exists(here))
    os.unlink(shared)


def a_bake_goes_on_where_its_replica_died(a, b, folder):
    settings = dict(BAKE, samples=12000, cube=16)
    model = a.ask().load(model_file(folder, 3), size_mm=10, name="slow", wait=False, **settings)
    time.sleep(0.3)
    a.kill()
    t = time.monotonic()
    until("the other bakes", 200, lambda: b.ask().info(model).state == "ready")
    want = b.ask().colors(model, "constant")
    print("a bake went on at the other replica: ready %.1f s after its own died" % (time.monotonic() - t))
    a.start()
    assert np.array_equal(until("back", 20, lambda: a.ask().colors(model, "constant")), want)


def a_full_folder_refuses_and_loses_nothing():
    """The shared folder alone is full: uploads and loads say so, what was there stays, and both go
    on once there is room. Wants to mount a small file system."""
    folder = tempfile.mkdtemp(prefix="relightd-full-")
    shared, r = folder + "/shared", None
    os.mkdir(shared)
    if os.geteuid() or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "none", shared],
                                      stderr=subprocess.DEVNULL).returncode:
        os.rmdir(shared)
        os.rmdir(folder)
        print("skipped: a full folder: no tmpfs can be mounted here")
        return
    try:
        r = Replica(folder, 1)
        first = r.ask().upload(b"small" * 1000, "small.bin")
        large = random.Random(5).randbytes(3 << 20)
        try:
            r.ask().upload(large, "large.bin")
            raise AssertionError("3 MiB went into a folder of 2")
        except relight.RelightError as error:
            assert error.code == "LIMIT" and "store" in str(error), (error.code, str(error))
            print("a full folder: %s" % error)
        with open("%s/blobs/%s/%s" % (shared, first[:2], first), "rb") as f:
            assert hashlib.sha256(f.read()).hexdigest() == first
        subprocess.run(["mount", "-o", "remount,size=64m", shared], check=True)
        name = r.ask().upload(large, "large.bin")
        assert name == hashlib.sha256(large).hexdigest()
        assert os.path.getsize("%s/blobs/%s/%s" % (shared, name[:2], name)) == len(large)
        r.stop()
    finally:
        if r and r.process.poll() is None:
            r.process.kill()
            r.process.wait()
        subprocess.run(["umount", "-l", shared])
        shutil.rmtree(folder, ignore_errors=True)


def nothing_acknowledged_is_lost(replicas, folder, n, rng):
    blobs, models, kills, failed = {}, {}, 0, 0
    for i in range(n):
        r = rng.choice(replicas)
        act = rng.random()
        try:
            if act < 0.70:
                data = rng.randbytes(rng.randrange(1, 60000))
                blobs[r.ask().upload(data, "blob%d" % i)] = len(data)
            elif act < 0.72 and len(models) < 8 + n // 500:
                scale = 100 + len(models)
                model = r.ask().load(model_file(folder, scale), size_mm=10, wait=False, **BAKE)
                models[model] = scale
            elif act < 0.96 and models:
                r.ask().info(rng.choice(list(models)))
            elif act > 0.97:
                r.kill()
                r.start()
                kills += 1
        except (relight.RelightError, OSError) as error:
            code = getattr(error, "code", "DISCONNECTED")
            assert code in ("DISCONNECTED", "UNREACHABLE", "BUSY"), (code, str(error))
            r.client, failed = None, failed + 1
    for model in models:
        want = None
        for r in replicas:
            until("%s at %d" % (model, r.number), 120, lambda: r.ask().info(model).state == "ready")
            got = r.ask().colors(model, "constant")
            assert want is None or np.array_equal(got, want)
            want = got
    for name, size in blobs.items():
        with open("%s/blobs/%s/%s" % (shared_folder(folder, 1), name[:2], name), "rb") as f:
            data = f.read()
        assert len(data) == size and hashlib.sha256(data).hexdigest() == name, name
    print("%d operations, %d kills, %d refused or cut: %d blobs and %d bakes intact"
          % (n, kills, failed, len(blobs), len(models)))
    assert kills > 0 and len(blobs) > n // 3


def main():
    seed = int(os.environ.get("SEED", "1"))
    with replicas_in_a_folder("replicas") as (folder, replicas):
        replicas.append(Replica(folder, 1))
        replicas.append(Replica(folder, 2))
        if "RELIGHT_TEST_MOUNTS" not in os.environ:
            a_full_folder_refuses_and_loses_nothing()
        each_serves_what_the_other_took(*replicas, folder)
        if "RELIGHT_TEST_MOUNTS" not in os.environ:
            what_is_fetched_for_a_forgotten_model_goes(*replicas, folder)
        a_record_is_missing_for_a_moment(replicas[0], folder)
        a_record_that_is_too_long_hides_no_other(*replicas, folder)
        a_bake_goes_on_where_its_replica_died(*replicas, folder)
        nothing_acknowledged_is_lost(replicas, folder, int(sys.argv[3]), random.Random(seed))


main()
