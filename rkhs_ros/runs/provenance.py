"""Provenance of a run: the versions on which bit-identical results depend besides the settings."""

import platform
from importlib.metadata import version

from rkhs_ros import __version__

LIBRARIES = {name: version(name) for name in ("numpy", "scipy")}


def provenance() -> dict[str, str]:
    """Return the versions on which the results of a run depend, by name."""
    return {"Python": platform.python_version(), "rkhs_ros": __version__, **LIBRARIES}


def provenance_lines() -> tuple[str, ...]:
    """Return the provenance as texts, "name version" each."""
    return tuple(f"{name} {version}" for name, version in provenance().items())
