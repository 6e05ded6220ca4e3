# SPDX-License-Identifier: MIT
"""Makes relight/relight.desc of the protocol's schema before the package is built."""
import os
import subprocess

from setuptools import setup
from setuptools.command.build_py import build_py

HERE = os.path.dirname(os.path.abspath(__file__))
SCHEMA = os.path.join(HERE, "..", "..", "proto")


class Build(build_py):
    def run(self) -> None:
        made = os.path.join(HERE, "relight", "relight.desc")
        if os.path.exists(os.path.join(SCHEMA, "relight.proto")):
            subprocess.run(["protoc", "--proto_path=" + SCHEMA, "--descriptor_set_out=" + made,
                            "relight.proto"], check=True)
        elif not os.path.exists(made):
            raise SystemExit("error: neither proto/relight.proto nor relight/relight.desc is here")
        super().run()


setup(cmdclass={"build_py": Build})
