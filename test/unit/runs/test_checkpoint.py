import os
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rkhs_ros.learning.algorithms.function_spaces import GridSettings
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.episodes import discard
from rkhs_ros.learning.iteration import Row
from rkhs_ros.learning.state import State
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import training_from
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.recordings.recording import FILE as RECORDING
from rkhs_ros.recordings.recording import RecordedBatch, countable
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.checkpoint import COUNTS, FILE, Checkpoint, Checkpoints, read_checkpoint, write_checkpoint
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.curve import BEGINNING
from rkhs_ros.runs.recorded import memory_of
from test.unit.conftest import model_free

TINY = model_free(iterations=4, episodes_per_iteration=2, evaluation_episodes=1, horizon=3)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TINY)
TOY = InlineRunner(Simulation("rkhs/Toy-v0"))
WAYS: list[Any] = [
    *ALGORITHMS,
    {"name": "rkhs_nac", "step": {"rule": "line_search", "choices": 3}},
    {"name": "rkhs_nac", "exploration_decay": 0.9, "critic": "trajectory"},
    {"name": "rkhs_nac", "variance": "learnt", "reuse": 4},
    {"name": "rkhs_power", "reuse": 3},
    {"name": "rkhs_power", "variance": "as_published"},
    {"name": "power", "reuse": 3, "variance": "constant", "exploration_decay": 0.9},
]

ArraysOf = Callable[[Any], dict[str, np.ndarray]]


def config_of(way: Any) -> Config:
    way = {"name": way} if isinstance(way, str) else way
    on_grid = issubclass(ALGORITHMS[way["name"]], GridSettings)
    size = {"grid_counts": 3, "grid_low": [-4.0], "grid_high": [4.0]} if on_grid else {"centres": 6}
    tree = {"iterations": 4, "episodes_per_iteration": 3, "evaluation_episodes": 2, "horizon": 6}
    parts = {"kernel": {"bandwidth": 4.0} if on_grid else {}, "algorithm": size | way, "model": {"form": "none"}}
    return Config(Environment("rkhs/Toy-v0", {}), training_from(tree | parts))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / RECORDING).touch()
    return tmp_path


@pytest.fixture
def states() -> list[State]:
    """Return the initial state and the states after the iterations of a tiny run."""
    return [iteration.state for iteration in train(TINY, TOY)]


def rows(count: int) -> list[Row]:
    return [BEGINNING._replace(iteration=k, seconds=0.1 * k) for k in range(1, count + 1)]


def assert_same_bits(one: Any, other: Any, arrays_of: ArraysOf) -> None:
    a, b = arrays_of(one), arrays_of(other)
    assert a.keys() == b.keys()
    for name in a:
        assert (a[name].dtype, a[name].shape) == (b[name].dtype, b[name].shape)
        assert a[name].tobytes() == b[name].tobytes()


def assert_same_state(one: State, other: State, arrays_of: ArraysOf) -> None:
    assert_same_bits(one, other, arrays_of)
    assert all(getattr(one, name) == getattr(other, name) for name in COUNTS)
    assert one.policy.mean.kernel == other.policy.mean.kernel
    assert one.policy.inputs == other.policy.inputs


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_every_algorithm_resumes_bit_identically_from_each_checkpoint(
    folder: Path, way: Any, arrays_of: ArraysOf
) -> None:
    config = config_of(way)
    on_grid = isinstance(config.training.algorithm, GridSettings)
    inputs = Inputs(angles=(0.0,)) if on_grid else Inputs(history=2, angles=(0.0,), degree=2)
    config = replace(config, training=replace(config.training, inputs=inputs))
    batches: list[RecordedBatch] = []
    TOY.record = lambda batch, episodes, _: batches.append(RecordedBatch(batch, 1, episodes, [], 0))
    whole = list(train(config.training, TOY))
    TOY.record = discard
    episodes = countable(batches)
    for k, iteration in enumerate(whole[:-1], 1):
        lines = [each.row(0.1) for each in whole[:k]]
        write_checkpoint(folder, config, Checkpoint(iteration.state, lines))
        found = found_in(folder, config)
        assert repr(found.rows) == repr(lines)
        ends = [each.episodes for each in lines]
        memory = memory_of(ends, config.training, found.state.policy, TOY.spaces, episodes, "recording")
        state = replace(found.state, memory=memory)
        assert_same_state(state, iteration.state, arrays_of)
        rest = list(train(config.training, TOY, state))
        assert len(rest) == len(whole) - k
        for one, other in zip(whole[k:], rest, strict=True):
            assert_same_bits(one, other, arrays_of)
            assert one.metrics == other.metrics
            assert_same_state(one.state, other.state, arrays_of)


def test_the_state_contains_the_memory() -> None:
    *_, last = train(config_of({"name": "power", "reuse": 3}).training, TOY)
    assert len(last.state.memory) == 3  # otherwise the test above would be vacuous


def write(folder: Path, state: State, config: Config = CONFIG) -> Path:
    best, given = (replace(state.policy, action_repeat=repeat) for repeat in (2, 3))
    write_checkpoint(folder, config, Checkpoint(state, rows(state.iterations), best, given))
    return folder / FILE


def found_in(folder: Path, config: Config = CONFIG) -> Checkpoint:
    found = read_checkpoint(folder, config)
    assert found is not None
    return found


def test_a_checkpoint_is_read_as_written(folder: Path, states: list[State], arrays_of: ArraysOf) -> None:
    assert read_checkpoint(folder, CONFIG) is None
    write(folder, states[2])
    found = found_in(folder)
    assert_same_state(replace(found.state, memory=states[2].memory), states[2], arrays_of)
    assert str(found.rows) == str(rows(3))
    assert found.best_policy is not None
    assert found.best_policy.action_repeat == 2
    assert found.given is not None
    assert found.given.action_repeat == 3


@pytest.mark.usefixtures("quick_disk")
@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_flipped_bit_is_detected_or_harmless(
    folder: Path, states: list[State], arrays_of: ArraysOf, data: st.DataObject
) -> None:
    path = write(folder, states[1])
    content = bytearray(path.read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(content)
    with suppress(ValueError):
        assert_same_state(replace(found_in(folder).state, memory=states[1].memory), states[1], arrays_of)


def test_fewer_iterations_than_finished_are_rejected(folder: Path, states: list[State]) -> None:
    write(folder, states[2])
    assert [found_in(folder, changed(iterations=n)).state.iterations for n in (4, 9)] == [3, 3]
    with pytest.raises(ValueError, match="iterations: expected at least 4, more than the finished ones, got 3"):
        read_checkpoint(folder, changed(iterations=3))


def changed(**changes: Any) -> Config:
    return replace(CONFIG, training=replace(TINY, **changes))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (changed(horizon=4, discount=0.5), "horizon: expected 3 as at the start of the run, got 4. "),
        (changed(algorithm=ALGORITHMS["power"]()), "algorithm.name: expected rkhs_nac as .* got power. "),
        (
            replace(CONFIG, environment=Environment("rkhs/Pendulum-v0", {"angle": "clip"})),
            "environment.id: expected rkhs/Toy-v0 as at the start of the run, got rkhs/Pendulum-v0. ",
        ),
        (
            replace(CONFIG, environment=Environment("rkhs/Toy-v0", {"start": 1})),
            "environment.options.start: expected no such setting as at the start of the run, got 1. ",
        ),
    ],
)
def test_a_checkpoint_with_other_settings_is_rejected_with_the_first_difference(
    folder: Path, states: list[State], config: Config, message: str
) -> None:
    write(folder, states[2])
    with pytest.raises(ValueError, match=message) as refusal:
        read_checkpoint(folder, config)
    assert str(refusal.value).startswith(f"{folder}: ")
    assert "\n" not in str(refusal.value)


class Clock:
    """Clock with a settable time."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the synced files in order."""
    names: list[str] = []
    fsync = os.fsync

    def watched(descriptor: int) -> None:
        names.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", watched)
    return names


def test_a_checkpoint_is_written_at_most_once_a_second_and_at_the_end_always_on_the_disk(
    folder: Path, states: list[State], synced: list[str]
) -> None:
    clock = Clock()
    checkpoints = Checkpoints(folder, changed(iterations=99), clock=clock)
    written = []
    for k, clock.now in enumerate((0.2, 0.99, 1.2, 1.5, 1.99, 2.3, 2.5, 7.0, 7.5), 1):
        checkpoints.add(Checkpoint(replace(states[0], iterations=k), rows(k)))
        if synced:
            assert synced == [RECORDING, f"{FILE}.part", folder.name]
        synced.clear()
        written.append(found_in(folder, changed(iterations=99)).state.iterations)
    assert written == [1, 1, 3, 3, 3, 6, 6, 8, 8]
    checkpoints.close()
    assert found_in(folder, changed(iterations=99)).state.iterations == 9
    synced.clear()
    checkpoints.close()
    assert synced == []


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_an_interrupted_write_keeps_the_earlier_checkpoint(folder: Path, states: list[State], call: str) -> None:
    """Kill a process at a system call of its second checkpoint."""
    path = write(folder, states[0])
    before = path.read_bytes()
    if (child := os.fork()) == 0:
        setattr(os, call, lambda *arguments, **options: os.kill(os.getpid(), signal.SIGKILL))
        write(folder, states[1])
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert path.read_bytes() == before
    assert (folder / f"{FILE}.part").exists()
    write(folder, states[1])
    assert found_in(folder).state.iterations == 2
    assert not (folder / f"{FILE}.part").exists()
