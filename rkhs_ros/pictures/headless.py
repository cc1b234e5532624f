"""How MuJoCo draws where there is no display."""

from __future__ import annotations

import os
import sys
from collections.abc import MutableMapping
from ctypes.util import find_library

RENDERER = "MUJOCO_GL"  # environment variable that MuJoCo and Gymnasium read
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
OFFSCREEN = {"egl": "EGL", "osmesa": "OSMesa"}  # renderer and its library, the quicker one first
REMEDY = (
    "MuJoCo without a display needs EGL or OSMesa: on Debian and Ubuntu, apt install libegl1 libgl1-mesa-dri, "
    "or libosmesa6 and MUJOCO_GL=osmesa"
)


def choose_renderer(environment: MutableMapping[str, str] = os.environ) -> None:
    """Have MuJoCo draw off screen where there is no display and nobody has chosen how."""
    has_display = sys.platform != "linux" or any(environment.get(name) for name in DISPLAYS)
    if has_display or RENDERER in environment:
        return
    found = [renderer for renderer, library in OFFSCREEN.items() if find_library(library)]
    if found:
        environment[RENDERER] = found[0]


def remedy(environment: MutableMapping[str, str] = os.environ) -> str:
    """Return in brackets what to install for pictures of MuJoCo; nothing where MuJoCo is not used."""
    said = f"{RENDERER} is {environment[RENDERER]}; " if RENDERER in environment else ""
    return f" ({said}{REMEDY})" if "mujoco" in sys.modules else ""
