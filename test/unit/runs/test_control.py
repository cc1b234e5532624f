"""Commands from outside pause, resume and stop a run between two iterations; other content is ignored."""

import fcntl
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.lock import is_locked, locked
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.control import ASKED, PAUSE, RESUME, STOP, WORDS, Control, ask, is_pausing
from rkhs_ros.runs.run import run_training

TOY = Path(__file__).parents[3] / "config" / "toy_few_nac.yaml"


class Rest:
    """Replacement for the wait during a pause: each call sends the next command or writes its bytes."""

    def __init__(self, folder: Path, *then: str | bytes) -> None:
        self.folder, self.then = folder, list(then)
        self.paused: list[bool] = []

    def __call__(self, seconds: float) -> None:
        self.paused.append(is_pausing(self.folder))
        word = self.then.pop(0)
        ask(self.folder, word) if isinstance(word, str) else (self.folder / ASKED).write_bytes(word)


def test_a_run_without_commands_continues(tmp_path: Path) -> None:
    Control(tmp_path, rest=Rest(tmp_path)).obey()
    assert not list(tmp_path.iterdir())


def test_a_pause_ends_only_with_resume_or_stop(tmp_path: Path) -> None:
    rest = Rest(tmp_path, PAUSE, b"\xff\x00garbage" * 1000, b"", RESUME)
    control = Control(tmp_path, rest=rest)
    ask(tmp_path, PAUSE)
    assert not is_pausing(tmp_path)
    control.obey()
    assert rest.paused == [True] * 4
    assert not list(tmp_path.iterdir())


def test_a_paused_run_can_be_stopped(tmp_path: Path) -> None:
    for first, rest in ((STOP, Rest(tmp_path)), (PAUSE, Rest(tmp_path, STOP))):
        control = Control(tmp_path, rest=rest)
        ask(tmp_path, first)
        with pytest.raises(KeyboardInterrupt):
            control.obey()
        assert not is_pausing(tmp_path)


def test_commands_for_an_earlier_run_are_discarded(tmp_path: Path) -> None:
    ask(tmp_path, STOP)
    Control(tmp_path).obey()


@given(st.binary(max_size=100).filter(lambda content: content not in {word.encode() for word in WORDS}))
def test_invalid_commands_are_ignored(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    folder = tmp_path_factory.mktemp("run")
    control = Control(folder, rest=Rest(folder))
    (folder / ASKED).write_bytes(content)
    control.obey()
    assert not list(folder.iterdir())


def test_unknown_commands_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unknown command 'arm'"):
        ask(tmp_path, "arm")


def test_a_stopped_run_saves_its_policy_and_resumes_bit_identically(tmp_path: Path) -> None:
    config = load_config(TOY, ["iterations=4"])
    whole = run_training(config, runner_of(config.environment), tmp_path / "whole", quiet=True)
    stopped = tmp_path / "stopped"
    with pytest.raises(KeyboardInterrupt):
        run_training(config, asking(stopped, STOP), stopped, quiet=True)
    assert (stopped / "policy.npz").exists()
    run_training(config, runner_of(config.environment), stopped, quiet=True, resume=True)
    assert (stopped / "policy.npz").read_bytes() == (whole / "policy.npz").read_bytes()


def asking(folder: Path, word: str) -> object:
    """Return a runner that sends a command to the run during its first episodes."""
    config = load_config(TOY)
    runner = runner_of(config.environment)
    collect = runner.collect

    def ask_first(*arguments: object) -> object:
        ask(folder, word)
        return collect(*arguments)

    runner.collect = ask_first
    return runner


@pytest.fixture
def looking(tmp_path: Path) -> Iterator[Callable[[], None]]:
    """Check continuously whether a run is active."""
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "lock").touch()
    ended: list[bool] = []

    def look() -> None:
        while not ended:
            is_locked(tmp_path)

    thread = Thread(target=look)
    thread.start()
    yield
    ended.append(True)
    thread.join()


@pytest.mark.usefixtures("looking")
def test_watching_a_run_does_not_prevent_its_start(tmp_path: Path) -> None:
    for _ in range(200):
        with locked(tmp_path):
            assert is_locked(tmp_path)


def test_a_slow_watcher_delays_the_start_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    started: list[bool] = []

    def start() -> None:
        with locked(tmp_path):
            started.append(True)

    thread = Thread(target=start)
    with (tmp_path / "checkpoints" / "lock").open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        thread.start()
        time.sleep(0.05)  # passes as well if the thread has not tried yet
        assert not started
    thread.join()
    assert started


def test_a_folder_without_a_run_is_not_locked(tmp_path: Path) -> None:
    assert not is_locked(tmp_path)
    with locked(tmp_path):
        pass
    assert not is_locked(tmp_path)
