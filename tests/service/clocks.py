#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Two relightd on one folder (--store), the clock of one an hour ahead (libfaketime): it says so; each serves what the
other took; a bake under way is not taken over, and one whose replica died is; objects in use are not collected; a link
that has ended by one clock is refused with words about it.

   clocks.py FOLDER_OF_THE_PROGRAMS FOLDER_OF_THE_PACKAGE"""
import glob
import os
import re
import subprocess
import sys
import urllib.error
import urllib.request

from replica import BAKE, Replica, model_file, replicas_in_a_folder, until

import numpy as np

LIBRARY = (glob.glob("/usr/lib/*/faketime/libfaketimeMT.so.1") or [None])[0]


def web(r):
    return int(re.search(r"listen address=http:127\.0\.0\.1:(\d+)", r.log()).group(1))


def each_serves_what_the_other_took(a, b, folder):
    for r, other, scale in ((a, b, 1), (b, a, 2)):
        model = r.ask().load(model_file(folder, scale), size_mm=10, name="ball%d" % scale, **BAKE)
        want = r.ask().colors(model, "constant")
        assert np.array_equal(other.ask().colors("ball%d" % scale, "constant"), want)
    print("each serves what the other took")


def bakes_are_not_taken_over(a, b, folder):
    settings = dict(BAKE, samples=12000)
    for r, other, scale in ((a, b, 3), (b, a, 4)):
        model = r.ask().load(model_file(folder, scale), size_mm=10, wait=False, **settings)
        until("its claim", 60, lambda: glob.glob("%s/shared/claims/%s.*" % (folder, model)))
        # The other asks for the same: it waits for the bake that is under way.
        assert other.ask().load(model_file(folder, scale), size_mm=10, wait=False, **settings) == model
        until("the bake", 300, lambda: other.ask().info(model).state == "ready")
        until("the bake at its own", 60, lambda: r.ask().info(model).state == "ready")
        for text in (a.log(), b.log()):
            assert "has taken over its claim" not in text
    model = b.ask().load(model_file(folder, 5), size_mm=10, wait=False, **settings)
    until("its claim", 60, lambda: glob.glob("%s/shared/claims/%s.*" % (folder, model)))
    b.kill()
    until("the other bakes it", 300, lambda: a.ask().info(model).state == "ready")
    b.start()
    until("it is back", 60, lambda: b.ask().colors(model, "constant").shape == (6, 3))
    print("bakes under way are not taken over, a dead one's is")


def links_end_with_words(a, b):
    """A link for ten minutes that the slow clock signed has ended by the other."""
    def signed(lifetime):
        done = subprocess.run([sys.argv[1] + "/relight", "-s", a.address, "sign",
                               "/v1/models/ball1/image.png?env=constant&size=32x24", "--expires", lifetime],
                              capture_output=True, text=True, check=True)
        return re.search(r"/v1/models/\S*", done.stdout).group(0)

    def get(r, path):
        try:
            return urllib.request.urlopen("http://127.0.0.1:%d%s" % (web(r), path), timeout=60).status, ""
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()
    short = signed("10m")
    assert get(a, short)[0] == 200
    status, text = get(b, short)
    assert status in (401, 403, 410) and re.search("expired|ended", text), (status, text)
    print("a link that has ended by the clock: %d %s" % (status, re.search(r'"detail":\s*"([^"]*)', text).group(1)))


def main():
    if not LIBRARY:
        print("skipped: no libfaketime; deploy/dependencies --tests installs it")
        sys.exit(77)
    ahead = dict(os.environ, LD_PRELOAD=LIBRARY, FAKETIME="+3600", NO_FAKE_STAT="1", FAKETIME_DONT_FAKE_MONOTONIC="1",
                 # a preloaded library comes before the sanitizer's
                 ASAN_OPTIONS=os.environ.get("ASAN_OPTIONS", "") + ":verify_asan_link_order=0")
    os.environ["RELIGHT_TOKEN"] = "a-token-of-both-replicas-0123456789"
    with replicas_in_a_folder("clocks") as (folder, replicas):
        with open(folder + "/token", "w", encoding="ascii") as f:
            f.write("a-token-of-both-replicas-0123456789\n")
        more = ("--http", "127.0.0.1:0", "--token-file", folder + "/token", "--store-keep", "86400")
        replicas.append(Replica(folder, 1, more=more))
        replicas.append(Replica(folder, 2, more=more, env=ahead))
        a, b = replicas
        assert re.search(r"clock is (3[56]\d\d) s ahead of that of --store", b.log()), "it does not say so"
        assert "clock is" not in a.log()
        each_serves_what_the_other_took(a, b, folder)
        links_end_with_words(a, b)
        before = set(glob.glob(folder + "/shared/b*/*/*"))
        bakes_are_not_taken_over(a, b, folder)
        assert before <= set(glob.glob(folder + "/shared/b*/*/*")), "objects in use were collected"


main()
