"""Completions of the command line, from the shells themselves."""

import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.runs.config import Config, Environment
from test.unit.conftest import Result, assert_refused, command_line

ASK = """
source "$0"
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMP_LINE="$*"
COMP_POINT=${#COMP_LINE}
handler=$(complete -p rkhs | grep -o -- '-F [^ ]*')
"${handler#-F }" rkhs "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""
TIMEOUT_S = 20.0
Ask = Callable[..., set[str]]


def script_for(shell: str, folder: Path, captured: pytest.CaptureFixture[str]) -> Path:
    code, out, err = command_line(captured)("completion", shell)
    assert (code, err) == (0, "")
    (folder / "_rkhs").write_text(out)
    return folder / "_rkhs"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a configuration, another file, and a run."""
    pytest.importorskip("shtab")
    (tmp_path / "work" / "runs" / "first").mkdir(parents=True)
    for name in ("mine.yaml", "mine.npz"):
        (tmp_path / "work" / name).touch()
    return tmp_path / "work"


@pytest.fixture
def ask(folder: Path, capsys: pytest.CaptureFixture[str]) -> Ask:
    """Return a function that asks bash for the completions of the last of some words."""
    script = script_for("bash", folder.parent, capsys)

    def completions(*words: str) -> set[str]:
        command = ["bash", "--norc", "-c", ASK, script, "rkhs", *words]
        asked = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        assert asked.stderr == ""
        return set(asked.stdout.split())

    return completions


def test_bash_completes_commands_options_and_choices(ask: Ask) -> None:
    assert ask("comp") == {"compare", "completion"}
    assert ask("train", "--se") == {"--seed", "--seeds", "--set"}
    assert ask("train", "mine.yaml", "--log", "") == {"tensorboard", "wandb"}
    assert ask("train", "mine.yaml", "--runner", "co") == {"composed"}
    assert ask("train", "mine.yaml", "--algorithm", "") == set(ALGORITHMS)
    assert ask("robot", "st") == {"start", "stop"}


def test_bash_completes_configurations_runs_and_tasks(ask: Ask) -> None:
    assert ask("train", "mi") == {"mine.yaml"}
    assert ask("evaluate", "mi") == {"mine.yaml", "mine.npz"}
    assert ask("export", "runs", "mi") == {"mine.yaml", "mine.npz"}
    assert ask("train", "--resume", "ru") == {"runs"}
    assert ask("publish", "runs", "ru") == {"runs"}
    assert ask("view", "runs/") == {"runs/first"}
    assert ask("train", "--env", "rkhs/Pend") == {"rkhs/Pendulum-v0", "rkhs/PendulumPOMDP-v0"}
    assert ask("check", "rkhs/Toy") == {"rkhs/Toy-v0"}


@pytest.mark.parametrize("name", ALGORITHMS)
def test_bash_completes_the_settings_of_every_algorithm(name: str, ask: Ask) -> None:
    training = replace(Training(), algorithm=ALGORITHMS[name]())
    wanted = {f"{key}=" for key in Config(Environment("rkhs/Toy-v0", {}), training).settings}
    assert wanted - ask("train", "mine.yaml", "--set", "") == {"environment.id="}
    assert "algorithm.ridge=" in ask("sweep", "mine.yaml", "--vary", "seed=1,2", "algorithm.ri")


@pytest.mark.skipif(shutil.which("zsh") is None, reason="needs zsh")
def test_zsh_completes_the_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = script_for("zsh", folder.parent, capsys)
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.execvpe("zsh", ["zsh", "-f", "-i"], {**os.environ, "TERM": "dumb", "PS1": "> ", "LC_ALL": "C"})
    try:
        os.write(
            terminal, f"fpath=({script.parent} $fpath); autoload -U compinit; compinit -u -D; echo rea''dy\n".encode()
        )
        read_until("\nready", terminal)
        cases = {
            "rkhs compl": "rkhs completion ",
            "rkhs train mi": "rkhs train mine.yaml ",
            "rkhs train --env rkhs/To": "rkhs train --env rkhs/Toy-v0 ",
            "rkhs train mine.yaml --set algorithm.ridge_n": "rkhs train mine.yaml --set algorithm.ridge_norm=",
        }
        for typed, completed in cases.items():
            os.write(terminal, f"{typed}\t".encode())
            read_until(completed, terminal)
            os.write(terminal, b"\x15")  # clears the line
    finally:
        os.close(terminal)
        os.waitpid(child, 0)


def read_until(expected: str, terminal: int) -> None:
    """Read what the shell prints until it contains a text."""
    shown, end = "", time.monotonic() + TIMEOUT_S
    while expected not in re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]|\r", "", shown):
        ready, _, _ = select.select([terminal], [], [], max(end - time.monotonic(), 0))
        assert ready, f"expected {expected!r}, got {shown!r}"
        shown += os.read(terminal, 4096).decode(errors="replace")


def test_a_missing_package_or_an_unknown_shell_is_reported(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    rkhs: Callable[..., Result] = command_line(capsys)
    remedy = "completion: expected shtab to be installed (pip install shtab, or the extra 'completion'), got none"
    assert_refused(rkhs("completion", "bash"), remedy)
    assert_refused(rkhs("completion", "fish"), "argument SHELL: invalid choice: 'fish'")
