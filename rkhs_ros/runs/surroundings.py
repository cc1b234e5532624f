"""What the bits of a run depend on beside its settings: the code, the libraries it computes with, their threads."""

from __future__ import annotations

from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from rkhs_ros import __version__
from rkhs_ros.base.threads import use_one_thread

CODE = tuple(f"rkhs_ros.{floor}" for floor in ("base", "rkhs", "policies", "learning", "runs"))
TASKS = ("sim_nodes",)  # the package of the project's tasks, which is known by its name only
LIBRARIES = {name: version(name) for name in ("numpy", "scipy", "gymnasium")}  # a learner imports no Gymnasium


def surroundings(*packages: str) -> dict[str, str]:
    """Return what a run's bits depend on, by name; one thread is set, and the number in use told.

    Args:
        packages: names of those whose code the run depends on, beside that which learns.
    """
    threads = {"threads of linear algebra": str(use_one_thread())}
    return {"rkhs_ros": f"{__version__}+{code_digest((*CODE, *packages))}", **LIBRARIES, **threads}


@cache
def code_digest(packages: tuple[str, ...]) -> str:
    """Return a few letters that follow from the packages' source files."""
    digest = blake2b(digest_size=4)
    for package in packages:
        for folder in getattr(find_spec(package), "submodule_search_locations", None) or ():
            for path in sorted(Path(folder).rglob("*.py")):
                digest.update(f"{package}/{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return digest.hexdigest()
