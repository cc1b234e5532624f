"""Search for modules in the working directory as well, in this process and in those that it starts."""

import os
import sys
from runpy import run_module


def search_here() -> None:
    """Search for modules in the working directory, after all other places."""
    if not searches_here():
        sys.path.append(os.getcwd())


def searches_here() -> bool:
    """Return whether this process searches for modules in the working directory."""
    return os.getcwd() in sys.path


def python(module: str) -> list[str]:
    """Return the command that runs a module in another process, which searches for modules where this one does."""
    return [sys.executable, "-P", "-m", *([__name__] if searches_here() else []), module]


if __name__ == "__main__":
    search_here()
    run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
