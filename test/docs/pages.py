"""Read the pages of the documentation, and run the code blocks of a page in a folder."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import dropwhile, groupby
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
TIMEOUT_S = 600  # per page; an idle machine needs at most a minute or two
LINKED = ("config", "launch", "requirements")  # folders that the commands of a page read


@dataclass(frozen=True)
class Block:
    """A fenced code block of a page, with the HTML comment before it."""

    language: str
    code: str
    comment: str
    line: int

    @property
    def is_run(self) -> bool:
        return self.language in RUN and not NOT_RUN.fullmatch(self.comment)


def blocks(page: Path) -> list[Block]:
    """Return the fenced code blocks of a page."""
    tokens = MarkdownIt().parse(page.read_text())
    before = ["", *(token.content.strip() if token.type == "html_block" else "" for token in tokens)]
    fences = ((token, comment) for token, comment in zip(tokens, before, strict=False) if token.type == "fence")
    return [Block(t.info.strip(), t.content, comment, t.map[0] + 1) for t, comment in fences if t.map]


def commands(block: Block) -> list[list[str]]:
    """Return the arguments of each `rkhs` command of a bash block."""
    found = []
    for line in block.code.replace("\\\n", " ").splitlines():
        shell = shlex.shlex(line, posix=True, punctuation_chars=True)
        shell.whitespace_split = True
        for is_operator, words in groupby(shell, lambda word: set(word) <= set(";&|<>()")):
            command = list(dropwhile(lambda word: "=" in word, words))
            if command[:1] == ["rkhs"] and not is_operator:
                found.append(command[1:])
    return found


def run_blocks(page: Path) -> None:
    """Run the blocks of a page in order, in the current folder; Python blocks share a namespace."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page):
        if not block.is_run:
            continue
        print(f"{page.name}:{block.line}", flush=True)
        if file := FILE.fullmatch(block.comment):
            _copy_package(file[1])
            Path(file[1]).write_text(block.code)
        elif place := INTO.fullmatch(block.comment):
            _copy_package(place[1])
            _insert(Path(place[1]), block.code, place[2] == "for", place[3])
        elif block.language == "bash":
            subprocess.run(["bash", "-euo", "pipefail", "-c", block.code], check=True)
        else:
            exec(compile(block.code, f"{page.name}:{block.line}", "exec"), namespace)


def _copy_package(name: str) -> None:
    """Copy the package of a file to the current folder, so that the block changes the copy."""
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


def run_page(page: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the blocks of a page in a folder, in a separate process."""
    for name in LINKED:
        (folder / name).symlink_to(ROOT / name)
    path = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path), "MPLBACKEND": "agg"}
    command = [sys.executable, __file__, str(page)]
    return subprocess.run(command, cwd=folder, env=environment, text=True, capture_output=True, timeout=TIMEOUT_S)


def links(page: Path) -> Iterator[str]:
    for token in MarkdownIt().enable("table").parse(page.read_text()):
        for child in token.children or []:
            target = child.attrGet("href") or child.attrGet("src")
            if target:
                yield str(target)


@cache
def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as on GitHub and on the site."""
    tokens = MarkdownIt().parse(page.read_text())
    texts = [tokens[i + 1] for i, token in enumerate(tokens) if token.type == "heading_open"]
    words = ("".join(child.content for child in text.children or []) for text in texts)
    return {re.sub(r"[^\w\- ]", "", word.lower()).replace(" ", "-") for word in words}


if __name__ == "__main__":
    run_blocks(Path(sys.argv[1]))
