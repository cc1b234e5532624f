"""Completion of the command line by argcomplete, as a shell requests it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected"),
    [("train --se", {"--seed", "--seeds", "--set"}), ("train mi", {"mine.yaml "}), ("publ", {""})],
)
def test_argcomplete_completes_commands_options_choices_and_files(
    words: str, expected: set[str], tmp_path: Path
) -> None:
    pytest.importorskip("argcomplete")
    (tmp_path / "mine.yaml").touch()
    line = f"rkhs {words}"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_STDOUT_FILENAME": "completions"}
    place = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9"}
    command = [sys.executable, "-m", "rkhs_ros.app.cli"]
    ended = subprocess.run(command, cwd=tmp_path, env={**os.environ, **asked, **place}, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    assert set((tmp_path / "completions").read_text().split("\n")) == expected
