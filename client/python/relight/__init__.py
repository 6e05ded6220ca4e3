# SPDX-License-Identifier: MIT
"""Client of relightd: light on translucent 3D models as NumPy arrays. See relight.Client."""
from .client import (Client, Environment, Geometry, Image, Link, Model, Progress, Server, View,
                     ViewFrame)
from .errors import RelightError

__all__ = ["Client", "Environment", "Geometry", "Image", "Link", "Model", "Progress", "RelightError",
           "Server", "View", "ViewFrame"]
__version__ = "0.1.0"
