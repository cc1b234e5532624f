"""What the bits of a run depend on beside its settings: the code, the libraries it computes with, their threads."""

from __future__ import annotations

import ast
import platform
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from rkhs_ros import __version__
from rkhs_ros.base.threads import use_one_thread

CODE = tuple(f"rkhs_ros.{floor}" for floor in ("base", "rkhs", "policies", "learning", "rollouts", "runs"))
TASKS = ("sim_nodes",)  # the package of the project's tasks, which is known by its name only
LIBRARIES = {name: version(name) for name in ("numpy", "scipy", "gymnasium")}  # a learner imports no Gymnasium


def provenance(*packages: str) -> dict[str, str]:
    """Return what a run's bits depend on, by name; one thread is set, and the number in use told.

    Args:
        packages: names of those whose code the run depends on, beside that which learns.
    """
    threads = {"threads of linear algebra": str(use_one_thread())}
    python = ".".join(platform.python_version_tuple()[:2])  # the syntax tree of the same code is another
    code = f"{__version__}+{code_digest((*CODE, *packages))}"
    return {"Python": python, "rkhs_ros": code, **LIBRARIES, **threads}


def provenance_lines(*packages: str) -> tuple[str, ...]:
    """Return the same as words, "name version" each."""
    return tuple(f"{name} {version}" for name, version in provenance(*packages).items())


@cache
def code_digest(packages: tuple[str, ...]) -> str:
    """Return a few letters that follow from what the packages' source files compute.

    Docstrings, comments and line breaks count for nothing.
    """
    digest = blake2b(digest_size=4)
    for package in packages:
        for folder in getattr(find_spec(package), "submodule_search_locations", None) or ():
            for path in sorted(Path(folder).rglob("*.py")):
                tree = ast.parse(path.read_bytes())
                tree.body = _without_docstrings(tree.body)
                digest.update(f"{package}/{path.relative_to(folder)}\0{ast.dump(tree)}\0".encode())
    return digest.hexdigest()


def _without_docstrings(statements: list[ast.stmt]) -> list[ast.stmt]:
    """Return statements less those that are a text only, and those within them alike."""
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
