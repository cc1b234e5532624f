"""A module that a file names is imported if Python finds it; only a command line extends the search to this folder."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rkhs_ros.base.processes import python, search_here
from test.unit.conftest import Result, assert_refused
from test.unit.rollouts.test_custom_environment import MODULE

Rkhs = Callable[..., Result]
INLINE = ("--runner", "inline", "--quiet")
SHORT = ("model.form=none", "episodes_per_iteration=2", "evaluation_episodes=1", "horizon=3", "discount=0.9")
NAME = "theirs:Slide-v0"
REFUSAL = (
    f"unknown environment '{NAME}': expected an importable module 'theirs', got ModuleNotFoundError: No module named "
    f"'theirs'. If it is in this folder, add --env {NAME}"
)


@pytest.fixture(autouse=True)
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Do not search the current folder before a test, and forget its module afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", os.getcwd())])
    yield
    sys.modules.pop("theirs", None)


@pytest.fixture
def foreign_run(rkhs: Rkhs, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a foreign run whose environment is in a module beside it, which reports its import."""
    Path("theirs.py").write_text(MODULE)
    train = ("train", "--env", NAME, *INLINE, "--iterations", 1, "--out", "run")
    done = rkhs(*train, "--set", *SHORT)
    assert f"rkhs evaluate run --env {NAME}; continue: rkhs train --resume run --env {NAME} --iterations 2" in done.out
    sys.modules.pop("theirs")
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != os.getcwd()])
    Path("theirs.py").write_text(f"open('imported', 'w').close()\n{MODULE}")
    return Path("run")


@pytest.mark.parametrize(
    "command", [("evaluate", "run/policy.npz"), ("imitate", "run"), ("train", "--resume", "run", *INLINE)], ids=" ".join
)
@pytest.mark.usefixtures("foreign_run")
def test_a_file_does_not_import_from_the_current_folder_and_the_error_names_the_option_that_does(
    rkhs: Rkhs, command: tuple[str, ...]
) -> None:
    assert_refused(rkhs(*command), REFUSAL)
    assert not Path("imported").exists()
    assert REFUSAL not in rkhs(*command, "--env", NAME).err  # rendering also needs an environment with pictures
    assert Path("imported").exists()


@pytest.mark.usefixtures("foreign_run")
def test_commands_without_an_environment_import_no_named_module(rkhs: Rkhs) -> None:
    for command in (("plot", "run"), ("replay", "run", "--quiet"), ("compare", "run"), ("offline", "run", "--quiet")):
        assert rkhs(*command).code == 0, command
    assert not Path("imported").exists()


def test_a_started_process_searches_where_this_one_does_and_nothing_in_the_folder_hides_another_module() -> None:
    Path("theirs.py").write_text("import json, sys; print(json.__name__, sys.argv)\n")
    Path("json.py").write_text("raise SystemExit('hidden')\n")

    def started() -> "subprocess.CompletedProcess[str]":
        return subprocess.run([*python("theirs"), "word"], capture_output=True, text=True, check=False)

    assert "No module named theirs" in started().stderr
    search_here()
    assert started().stdout == f"json {[str(Path('theirs.py').absolute()), 'word']}\n"
