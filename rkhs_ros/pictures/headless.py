"""Choose an off-screen renderer for MuJoCo on machines without a display."""

import os
import sys
from collections.abc import MutableMapping
from ctypes.util import find_library

RENDERER = "MUJOCO_GL"  # environment variable that MuJoCo and Gymnasium read
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
OFFSCREEN = {"egl": "EGL", "osmesa": "OSMesa"}  # renderer and its library, the faster one first
REMEDY = (
    "MuJoCo without a display needs EGL or OSMesa: on Debian and Ubuntu, apt install libegl1 libgl1-mesa-dri, "
    "or libosmesa6 and MUJOCO_GL=osmesa"
)


def choose_renderer(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set MuJoCo's renderer to an off-screen one if there is no display and the user has not chosen one."""
    has_display = sys.platform != "linux" or any(environment.get(name) for name in DISPLAYS)
    if has_display or RENDERER in environment:
        return
    found = [renderer for renderer, library in OFFSCREEN.items() if find_library(library)]
    if found:
        environment[RENDERER] = found[0]


def remedy(environment: MutableMapping[str, str] = os.environ) -> str:
    """Return in brackets what to install for rendering with MuJoCo; an empty string if MuJoCo is not in use."""
    chosen = f"{RENDERER} is {environment[RENDERER]}; " if RENDERER in environment else ""
    return f" ({chosen}{REMEDY})" if "mujoco" in sys.modules else ""
