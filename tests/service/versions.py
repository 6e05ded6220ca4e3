#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Two relightd of different versions of baker and format on one folder (--store), as in a rolling upgrade: each
answers for what the other loaded, by its name and by the other's id, with a bake of its own; neither deletes,
changes or opens a file of the other; a replica is upgraded, and goes back, with all that it had.

   versions.py FOLDER_OF_THE_PROGRAMS FOLDER_OF_THE_PACKAGE FOLDER_OF_THE_NEXT_PROGRAMS"""
import glob
import hashlib
import os
import struct
import sys

from replica import BAKE, Replica, model_file, replicas_in_a_folder, until

import numpy as np

OLD, NEXT = sys.argv[1], sys.argv[3]


def state_of(folder):
    """SHA-256 of every file of the shared folder that is not to change, by its name."""
    found = {}
    for kind in ("bakes", "blobs"):
        for path in glob.glob("%s/shared/%s/*/*" % (folder, kind)):
            with open(path, "rb") as f:
                found[path] = hashlib.sha256(f.read()).hexdigest()
    return found


def version_of(folder, model):
    with open("%s/shared/bakes/%s/%s.prt" % (folder, model[:2], model), "rb") as f:
        head = f.read(12)
    assert head[:4] == b"\x89PRT", head
    return struct.unpack("<I", head[8:])[0]


def records(folder):
    return {os.path.basename(p)[:-5] for p in glob.glob(folder + "/shared/records/*.json")}


def colours(replica, model):
    """Waits for the replica's own bake of it."""
    until("%s at %d" % (model, replica.number), 500, lambda: replica.ask().info(model).state == "ready")
    return replica.ask().colors(model, "constant")


def nothing_changed(before, folder):
    after = state_of(folder)
    for path, was in before.items():
        assert after.get(path) == was, path + (" is gone" if path not in after else " has other bytes")


def each_answers_for_the_other(old, new, folder):
    ball = old.ask().load(model_file(folder, 1), size_mm=10, name="ball", **BAKE)
    cup = new.ask().load(model_file(folder, 2), size_mm=10, name="cup", **BAKE)
    assert (version_of(folder, ball), version_of(folder, cup)) == (2, 3)
    before = state_of(folder)
    for a, b, name, model in ((old, new, "ball", ball), (new, old, "cup", cup)):
        want = a.ask().colors(model, "constant", rotate=30)
        colours(b, name)
        assert np.allclose(b.ask().colors(model, "constant", rotate=30), want, rtol=1e-5), "by the other's id"
        own = b.ask().info(name).id
        assert own != model and version_of(folder, own) == version_of(folder, cup if b is new else ball)
        # Now that both are there, too, a name stands for one model.
        assert a.ask().info(name).id == model and b.ask().info(model).id == own
        for r in (a, b):
            listed = [m.id for m in r.ask().models() if m.name == name]
            assert listed == [model if r is a else own], "listed: %s" % listed
    nothing_changed(before, folder)
    assert len(state_of(folder)) >= len(before) + 2 and len(records(folder)) == 4
    print("each answers for what the other loaded, with a bake of its own")
    return ball, cup


def a_bake_goes_on_at_another_version(old, new, folder):
    """The one that bakes dies; the other, of another version, bakes the model itself."""
    slow = new.ask().load(model_file(folder, 3), size_mm=10, name="slow", wait=False,
                          **dict(BAKE, samples=12000))
    until("the record", 20, lambda: slow in records(folder))
    new.kill()
    until("the other bakes", 200, lambda: old.ask().info("slow").state == "ready")
    own = old.ask().info("slow").id
    assert own != slow and old.ask().info(slow).id == own
    new.start()
    colours(new, slow)
    print("a bake whose replica died goes on at one of another version")


def there_and_back(old, new, folder, ball, cup):
    """The old replica becomes a new one, with the data it had, and an old one again."""
    before, there = state_of(folder), records(folder)
    want = colours(old, ball)
    old.stop()
    old.programs = NEXT
    old.client = None
    old.start()
    for name in ("ball", "cup", ball, cup):
        colours(old, name)
    assert np.allclose(old.ask().colors(ball, "constant"), want, rtol=1e-5)
    nothing_changed(before, folder)
    old.stop()
    old.programs = OLD
    old.client = None
    mark = len(old.log())
    old.start()
    for name in ("ball", "cup", ball, cup):
        assert old.ask().colors(name, "constant").shape == (6, 3)
    assert np.array_equal(old.ask().colors(ball, "constant"), want)
    assert " started" not in old.log()[mark:], "it bakes again what it had"
    nothing_changed(before, folder)
    assert records(folder) >= there
    print("a replica is upgraded, and goes back, and bakes nothing twice")


def unloaded_everywhere(old, new, folder, ball):
    own = new.ask().info("ball").id
    new.ask().unload("ball", forget=True)
    until("unloaded at the old one", 20, lambda: "ball" not in [m.name for m in old.ask().models()])
    assert not {ball, own} & records(folder)
    print("what one unloads goes at the other, too")


def a_later_folder_is_refused(folder):
    shared = folder + "/later"
    os.mkdir(shared)
    with open(shared + "/store", "w", encoding="ascii") as f:
        f.write("relight store 2\n")
    process = Replica.start_process(OLD, folder, 9, shared)
    assert process.wait(60) != 0
    with open(folder + "/log9", encoding="utf-8") as f:
        text = f.read()
    assert 'relight store 2' in text and 'this relightd uses' in text, text
    assert os.listdir(shared) == ["store"] or not [
        p for p in glob.glob(shared + "/*/*") if os.path.isfile(p)], "it wrote into it"
    print("a folder of a later version is refused")


def main():
    with replicas_in_a_folder("versions") as (folder, replicas):
        replicas.append(Replica(folder, 1, OLD))
        replicas.append(Replica(folder, 2, NEXT))
        ball, cup = each_answers_for_the_other(*replicas, folder)
        a_bake_goes_on_at_another_version(*replicas, folder)
        there_and_back(*replicas, folder, ball, cup)
        unloaded_everywhere(*replicas, folder, ball)
        a_later_folder_is_refused(folder)


main()
