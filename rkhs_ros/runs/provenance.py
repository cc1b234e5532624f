"""Provenance of a run: code and libraries, on which bit-identical results depend besides the settings."""

from __future__ import annotations

import ast
import platform
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from rkhs_ros import __version__

CODE = tuple(f"rkhs_ros.{floor}" for floor in ("base", "rkhs", "policies", "learning", "rollouts", "runs"))
TASKS = ("sim_nodes",)  # package of the project's tasks, which this package must not import
# Looked up by name, since the learner does not import Gymnasium.
LIBRARIES = {name: version(name) for name in ("numpy", "scipy", "gymnasium")}


def provenance(*packages: str) -> dict[str, str]:
    """Return the versions on which the results of a run depend, by name.

    Args:
        packages: names of packages on whose code the run depends, besides the learner's.
    """
    python = ".".join(platform.python_version_tuple()[:2])  # syntax trees differ between versions
    code = f"{__version__}+{code_digest((*CODE, *packages))}"
    return {"Python": python, "rkhs_ros": code, **LIBRARIES}


def provenance_lines(*packages: str) -> tuple[str, ...]:
    """Return the provenance as texts, "name version" each."""
    return tuple(f"{name} {version}" for name, version in provenance(*packages).items())


@cache
def code_digest(packages: tuple[str, ...]) -> str:
    """Return a digest of the source files of packages, without docstrings, comments and line breaks."""
    digest = blake2b(digest_size=4)
    for package in packages:
        for folder in getattr(find_spec(package), "submodule_search_locations", None) or ():
            for path in sorted(Path(folder).rglob("*.py")):
                tree = ast.parse(path.read_bytes())
                tree.body = _without_docstrings(tree.body)
                digest.update(f"{package}/{path.relative_to(folder)}\0{ast.dump(tree)}\0".encode())
    return digest.hexdigest()


def _without_docstrings(statements: list[ast.stmt]) -> list[ast.stmt]:
    """Return statements without those that consist of a text only, recursively."""
    for each in statements:
        if isinstance(body := getattr(each, "body", None), list):
            each.body = _without_docstrings(body)  # type: ignore[attr-defined]
    return [each for each in statements if not _is_text(each)]


def _is_text(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )
