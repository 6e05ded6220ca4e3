#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Turns a light around a model and writes its colours as one array, and a picture.

   turn_light.py MODEL ENV [STEPS]     MODEL: a file, or the name of a loaded model
"""
import os
import sys

import numpy as np

import relight


def main() -> int:
    if len(sys.argv) not in (3, 4):
        print(__doc__, file=sys.stderr)
        return 2
    model, env, steps = sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) == 4 else 8
    try:
        with relight.Client() as client:
            if os.path.isfile(model):
                model = client.load(model, size_mm=50, material="marble", progress=lambda p: print(
                    "\r%s %3.0f %%   " % (p.stage, 100 * p.fraction), end="", file=sys.stderr))
            colors = np.stack([client.colors(model, env, rotate=360 * i / steps, format="coefficients")
                               for i in range(steps)])
            np.save("colors.npy", colors)
            with open("light.png", "wb") as f:
                f.write(client.image(model, env, size=(640, 480)).data)
    except relight.RelightError as error:
        print("error: %s" % error, file=sys.stderr)
        return 1
    print("colors.npy: %d turns of %d vertices, mean radiance %.4g; light.png" %
          (steps, colors.shape[1], colors.mean()))
    return 0


sys.exit(main())
