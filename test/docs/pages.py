"""The documentation as tests see it, and a program that does in a folder what a page says."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("**/*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]
RUN = ("python", "bash")  # languages
NOT_RUN = re.compile(r"<!-- not run: (.+) -->")
FILE = re.compile(r"<!-- file: (\S+) -->")
INTO = re.compile(r"<!-- in (\S+) (before|for): (.+) -->")
TIMEOUT_S = 200  # of a page, which takes some seconds where nothing else runs
LINKED = ("config", "launch", "requirements")  # what the commands of a page read, beside the code


@dataclass(frozen=True)
class Block:
    """A piece of code in a page, and the comment right before it."""

    language: str
    code: str
    comment: str
    line: int

    @property
    def is_run(self) -> bool:
        return self.language in RUN and not NOT_RUN.fullmatch(self.comment)


def blocks(page: Path) -> list[Block]:
    """Return the fenced code of a page."""
    tokens = MarkdownIt().parse(page.read_text())
    before = ["", *(token.content.strip() if token.type == "html_block" else "" for token in tokens)]
    fences = ((token, comment) for token, comment in zip(tokens, before, strict=False) if token.type == "fence")
    return [Block(t.info.strip(), t.content, comment, t.map[0] + 1) for t, comment in fences if t.map]


def do(page: Path) -> None:
    """Run the blocks of a page in order in the current folder; the Python ones share their names."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page):
        if not block.is_run:
            continue
        print(f"{page.name}:{block.line}", flush=True)
        if file := FILE.fullmatch(block.comment):
            _own_copy(file[1])
            Path(file[1]).write_text(block.code)
        elif place := INTO.fullmatch(block.comment):
            _own_copy(place[1])
            _insert(Path(place[1]), block.code, place[2] == "for", place[3])
        elif block.language == "bash":
            subprocess.run(["bash", "-euo", "pipefail", "-c", block.code], check=True)
        else:
            exec(compile(block.code, f"{page.name}:{block.line}", "exec"), namespace)


def _own_copy(name: str) -> None:
    """Have a copy of the code here where a file of it is changed."""
    package = Path(name).parts[0]
    if (ROOT / package / "__init__.py").is_file() and not Path(package).exists():
        shutil.copytree(ROOT / package, package, ignore=shutil.ignore_patterns("__pycache__"))


def _insert(path: Path, code: str, replace: bool, beginning: str) -> None:
    lines = path.read_text().splitlines(keepends=True)
    places = [i for i, line in enumerate(lines) if line.strip().startswith(beginning)]
    if len(places) != 1:
        raise ValueError(f"{path}: expected one line that begins with {beginning!r}, got {len(places)}")
    lines[places[0] : places[0] + replace] = [code]
    path.write_text("".join(lines))


def follow(page: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Do what a page says in a folder, in a process of its own."""
    for name in LINKED:
        (folder / name).symlink_to(ROOT / name)
    path = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path), "MPLBACKEND": "agg"}
    command = [sys.executable, __file__, str(page)]
    return subprocess.run(command, cwd=folder, env=environment, text=True, capture_output=True, timeout=TIMEOUT_S)


def links(page: Path) -> Iterator[str]:
    """Yield the targets of a page's links and pictures."""
    for token in MarkdownIt().enable("table").parse(page.read_text()):
        for child in token.children or []:
            target = child.attrGet("href") or child.attrGet("src")
            if target:
                yield str(target)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and the site make them."""
    tokens = MarkdownIt().parse(page.read_text())
    texts = [tokens[i + 1] for i, token in enumerate(tokens) if token.type == "heading_open"]
    words = ("".join(child.content for child in text.children or []) for text in texts)
    return {re.sub(r"[^\w\- ]", "", word.lower()).replace(" ", "-") for word in words}


if __name__ == "__main__":
    do(Path(sys.argv[1]))
