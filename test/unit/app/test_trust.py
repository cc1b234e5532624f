"""Data files may name only installed modules, unless the user trusts them."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

from rkhs_ros.app.cli import COMMANDS
from rkhs_ros.base.user_code import TRUSTED, is_installed, only_installed, user_module
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import resume_hint
from test.unit.conftest import Result, assert_refused
from test.unit.rollouts.test_custom_environment import MODULE

Rkhs = Callable[..., Result]
INLINE = ("--runner", "inline", "--quiet")
SHORT = ("episodes_per_iteration=2", "evaluation_episodes=1", "horizon=3")
REFUSAL = "expected an importable module 'theirs', installed, got none. A data file names it; to import"
CONFIGURED = {
    "check",
    "list",
    "reproduce",
    "robot",
    "simulate",
    "status",
    "sweep",
}  # read no data files


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Remove the module and its path before and after a test."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield
    sys.modules.pop("theirs", None)


@pytest.fixture
def foreign_run(rkhs: Rkhs, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a foreign run whose environment is in a module beside it, which reports its import."""
    Path("theirs.py").write_text(MODULE)
    train = ("train", "--env", "theirs:Slide-v0", *INLINE, "--iterations", 1, "--out", "run")
    assert rkhs(*train, "--set", *SHORT).code == 0
    sys.modules.pop("theirs")
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != os.getcwd()])
    Path("theirs.py").write_text(f"open('imported', 'w').close()\n{MODULE}")
    return Path("run")


@pytest.mark.parametrize(
    "command",
    [
        ("evaluate", "run"),
        ("evaluate", "run/policy.npz"),
        ("render", "run/policy.npz"),
        ("imitate", "run"),
        ("train", "--resume", "run", *INLINE),
    ],
    ids=" ".join,
)
@pytest.mark.usefixtures("foreign_run")
def test_data_files_cannot_import_modules_from_the_current_folder(rkhs: Rkhs, command: tuple[str, ...]) -> None:
    assert_refused(rkhs(*command), REFUSAL)
    assert not Path("imported").exists()
    assert REFUSAL not in rkhs(*command, "--trust").err  # rendering also needs an environment with pictures
    assert Path("imported").exists()
    assert TRUSTED not in os.environ


@pytest.mark.usefixtures("foreign_run")
def test_commands_without_an_environment_import_no_named_module(rkhs: Rkhs) -> None:
    for command in (("plot", "run"), ("replay", "run", "--quiet"), ("compare", "run"), ("offline", "run", "--quiet")):
        assert rkhs(*command).code == 0, command
    assert not Path("imported").exists()


@pytest.mark.usefixtures("foreign_run")
def test_an_environment_on_the_command_line_is_imported(rkhs: Rkhs) -> None:
    evaluated = rkhs("evaluate", "run/policy.npz", "--env", "theirs:Slide-v0", "--episodes", 1)
    assert json.loads(evaluated.out)["environment"] == "theirs:Slide-v0"
    other = rkhs("evaluate", "run/policy.npz", "--env", "Pendulum-v1")
    assert_refused(other, "--env: expected theirs:Slide-v0, the environment of run/policy.npz, got Pendulum-v1")


def test_a_finished_run_prints_trust_for_an_imported_module(rkhs: Rkhs) -> None:
    Path("theirs.py").write_text(MODULE)
    train = ("train", "--env", "theirs:Slide-v0", *INLINE, "--iterations", 1, "--out", "run", "--set", *SHORT)
    assert "rkhs train --resume run --trust --iterations 2" in rkhs(*train).out


def test_the_resume_hint_contains_trust(foreign_run: Path) -> None:
    assert (
        resume_hint(foreign_run, load_config(foreign_run / "config.yaml"))
        == "resume with: rkhs train --resume run --trust"
    )


@pytest.mark.parametrize("place", [".", "sub"])
def test_modules_in_the_current_folder_or_a_relative_path_are_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / place / "theirs.py").write_text("x = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path / place))  # like Python does at its start with the variable
    monkeypatch.setenv("PYTHONPATH", place)
    assert not is_installed("theirs")
    with only_installed(), pytest.raises(ValueError, match=REFUSAL):
        user_module("theirs")
    with only_installed("theirs"):
        assert user_module("theirs").x == 1
    sys.modules.pop("theirs")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / place))
    monkeypatch.chdir("/")
    assert is_installed("theirs")
    with only_installed():
        assert user_module("theirs").x == 1


def test_installed_modules_are_imported() -> None:
    names = ("json", "gymnasium.envs", "sim_nodes.envs", "rkhs_ros")
    assert all(map(is_installed, names))
    assert not any(map(is_installed, ("", ".", "../theirs", "/tmp/theirs", "no_such_module")))
    with only_installed():
        assert [user_module(name).__name__ for name in names] == list(names)


def test_every_command_that_reads_data_files_limits_imports() -> None:
    for name in set(COMMANDS) - CONFIGURED:
        module = import_module(f"rkhs_ros.app.commands.{name}")
        limited = [each for each in vars(module).values() if hasattr(each, "__wrapped__")]
        assert limited, name
