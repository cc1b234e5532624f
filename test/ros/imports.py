"""Runs a node, and at its exit writes the names of its imported modules to a file."""

import importlib
import sys
from pathlib import Path

if __name__ == "__main__":
    _, file, module, *arguments = sys.argv
    sys.argv = [module, *arguments]
    try:
        importlib.import_module(module).main()
    finally:
        Path(file).write_text("\n".join(sorted(sys.modules)))
