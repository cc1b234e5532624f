import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rkhs_ros import __version__
from rkhs_ros.learning.algorithms.function_spaces import GridSettings
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.execution import discard
from rkhs_ros.learning.state import State
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import training_from
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.storage import packed, unpacked
from rkhs_ros.recordings.batches import RecordedBatch, countable
from rkhs_ros.recordings.recording import FILE
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.checkpoint import COUNTS, Checkpoints
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.curve import BEGINNING, Row
from rkhs_ros.runs.recorded import with_memory
from test.unit.conftest import model_free

TINY = model_free(iterations=4, episodes_per_iteration=2, evaluation_episodes=1, horizon=3)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TINY)
TOY = InlineRunner(Simulation("rkhs/Toy-v0"))
WAYS: list[Any] = [
    *ALGORITHMS,
    {"name": "rkhs_nac", "step": {"rule": "line_search", "choices": 3, "episodes": 2}},
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
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / FILE).touch()
    return tmp_path


@pytest.fixture
def states() -> list[State]:
    """Return the initial state and the states after the iterations of a tiny run."""
    return [iteration.state for iteration in train(TINY, TOY)]


def rows(count: int) -> list[Row]:
    return [BEGINNING._replace(iteration=k, seconds=0.1 * k) for k in range(1, count + 1)]


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "checkpoints").iterdir())


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


@pytest.mark.parametrize("inputs", [Inputs(), Inputs(history=2, angles=(0.0,), degree=2)], ids=["plain", "inputs"])
@pytest.mark.parametrize("way", WAYS, ids=str)
def test_every_algorithm_resumes_bit_identically_from_each_checkpoint(
    folder: Path, way: Any, inputs: Inputs, arrays_of: ArraysOf
) -> None:
    config = config_of(way)
    if isinstance(config.training.algorithm, GridSettings) and inputs != Inputs():
        inputs = Inputs(angles=(0.0,))
    config = replace(config, training=replace(config.training, inputs=inputs))
    batches: list[RecordedBatch] = []
    TOY.record = lambda batch, episodes, _: batches.append(RecordedBatch(batch, 1, episodes, [], 0))
    whole = list(train(config.training, TOY))
    TOY.record = discard
    episodes = countable(batches)
    for k, iteration in enumerate(whole[:-1], 1):
        lines = [Row.of(each, 0.1) for each in whole[:k]]
        Checkpoints(folder, config).write(iteration.state, lines)
        found = Checkpoints(folder, config).newest()
        assert found is not None
        assert repr(found.rows) == repr(lines)
        state = with_memory(found, config.training, TOY.spaces, episodes, "recording")
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


def write(folder: Path, *states: State, config: Config = CONFIG) -> list[Path]:
    checkpoints = Checkpoints(folder, config)
    for state in states:
        checkpoints.write(state, rows(state.iterations))
    return [folder / "checkpoints" / f"{state.iterations:07}.npz" for state in states]


def newest(folder: Path, config: Config = CONFIG) -> int | None:
    found = Checkpoints(folder, config).newest()
    return None if found is None else found.state.iterations


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.usefixtures("quick_disk")
def test_a_truncated_checkpoint_is_skipped_with_a_warning(
    folder: Path, states: list[State], capsys: pytest.CaptureFixture[str]
) -> None:
    _, path = write(folder, *states[:2])
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        assert newest(folder) == 1
        err = capsys.readouterr().err
        assert err.startswith(f"warning: {path}: skipped (damaged, ")
        assert err.count("\n") == 1
    path.write_bytes(whole)
    assert newest(folder) == 2
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("quick_disk")
@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_flipped_bit_is_detected_or_harmless(
    folder: Path, states: list[State], arrays_of: ArraysOf, capsys: pytest.CaptureFixture[str], data: st.DataObject
) -> None:
    _, path = write(folder, *states[:2])
    content = bytearray(path.read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(content)
    found = Checkpoints(folder, CONFIG).newest()
    assert found is not None
    state = found.state
    written = states[state.iterations - 1]
    assert_same_state(replace(state, memory=written.memory), written, arrays_of)
    assert (f"warning: {path}: skipped (" in capsys.readouterr().err) is (state.iterations == 1)


@pytest.mark.usefixtures("quick_disk")
def test_a_flipped_bit_in_an_array_is_always_detected(folder: Path, states: list[State]) -> None:
    _, path = write(folder, *states[:2])
    whole = path.read_bytes()
    for array in (states[1].policy.mean.weights, states[1].policy.mean.centres):
        begin = whole.index(array.tobytes())
        for place in range(begin, begin + array.nbytes):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
            assert newest(folder) == 1


@pytest.mark.parametrize("content", [b"", b"PK", b"text\n", packed({"about": np.array(b"{}")}), packed({})])
def test_files_that_are_not_checkpoints_are_skipped(
    folder: Path, states: list[State], content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    _, path = write(folder, *states[:2])
    path.write_bytes(content)
    assert newest(folder) == 1
    assert f"warning: {path}: skipped (damaged, " in capsys.readouterr().err


def test_missing_checkpoints_give_no_state_but_only_damaged_ones_raise(
    folder: Path, states: list[State], capsys: pytest.CaptureFixture[str]
) -> None:
    assert newest(folder) is None
    for path in write(folder, *states[:2]):
        path.write_bytes(b"")
    with pytest.raises(
        ValueError, match=r"2\.npz: expected an intact checkpoint to resume from, got damaged ones only"
    ):
        newest(folder)
    assert capsys.readouterr().err.count(": skipped (") == 2


def test_a_damaged_checkpoint_before_an_intact_last_one_is_named(folder: Path, states: list[State]) -> None:
    before, last = write(folder, *states)[-2:]
    before.write_bytes(b"")
    expected = (
        f"{before}: expected an intact checkpoint from before the last iteration, got a damaged one and {last.name}"
    )
    with pytest.raises(ValueError, match=re.escape(expected)):
        newest(folder)


def test_the_last_iteration_is_repeated(folder: Path, states: list[State]) -> None:
    write(folder, *states)
    assert files(folder) == ["0000003.npz", "0000004.npz"]
    assert [newest(folder, config) for config in (CONFIG, changed(iterations=9))] == [3, 4]
    with pytest.raises(ValueError, match="iterations: expected at least 4, the number of finished iterations, got 3"):
        newest(folder, changed(iterations=3))


def test_file_names_sort_by_iteration(folder: Path, states: list[State]) -> None:
    config = replace(CONFIG, training=replace(TINY, iterations=10**6))
    write(folder, *(replace(states[0], iterations=n) for n in (99_999, 100_000)), config=config)
    assert newest(folder, config) == 100_000


def changed(**changes: Any) -> Config:
    return replace(CONFIG, training=replace(TINY, **changes))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (changed(seed=1), "seed: expected 0 as at the start of the run, got 1. "),
        (changed(horizon=4, discount=0.5), "horizon: expected 3 as at the start of the run, got 4. "),
        (changed(exploration_sd=(0.5,)), r"exploration_sd: expected \[1.0\] as at the start of the run, got \[0.5\]. "),
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
    *_, path = write(folder, *states)  # including the last iteration, from which no run resumes
    with pytest.raises(ValueError, match=message) as refusal:
        newest(folder, config)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)


def test_a_removed_option_is_rejected(folder: Path, states: list[State]) -> None:
    write(folder, *states, config=replace(CONFIG, environment=Environment("rkhs/Toy-v0", {"start": [1, {"a": 2.5}]})))
    with pytest.raises(ValueError, match=r"environment\.options\.start: expected .* got no such setting"):
        newest(folder)


def test_settings_without_effect_on_results_may_differ(folder: Path, states: list[State]) -> None:
    write(folder, *states)
    assert newest(folder, changed(iterations=5, timeout=1.0)) == 4


def test_a_checkpoint_of_another_schema_is_rejected(folder: Path, states: list[State]) -> None:
    path, *_ = write(folder, states[0])
    arrays = unpacked(path.read_bytes())
    about = arrays["about"].item().replace(b'"schema": 8', b'"schema": 9').replace(__version__.encode(), b"9.8.7")
    path.write_bytes(packed({"about": np.array(about)}))
    with pytest.raises(ValueError, match=r"a checkpoint of schema 8, got schema 9. Resume with rkhs_ros 9\.8\.7"):
        newest(folder)


@pytest.mark.parametrize("count", [b'"3"', b"null", b"-1", b"3.0"])
def test_a_checkpoint_with_invalid_counts_is_skipped(
    folder: Path, states: list[State], capsys: pytest.CaptureFixture[str], count: bytes
) -> None:
    *_, path = write(folder, *states[:3])
    for name in (b"iterations", b"explored"):
        arrays = unpacked(path.read_bytes())
        about = re.sub(b'("%s": )\\d+([,}](?!.*"%s"))' % (name, name), rb"\g<1>%s\g<2>" % count, arrays["about"].item())
        assert about != arrays["about"].item()
        path.write_bytes(packed({**arrays, "about": np.array(about)}))
        assert newest(folder) == 2
        assert "counts: expected whole numbers >= 0, got" in capsys.readouterr().err


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


def test_the_disk_is_synced_once_a_second(folder: Path, states: list[State], synced: list[str]) -> None:
    clock = Clock()
    checkpoints = Checkpoints(folder, CONFIG, clock=clock)
    due = []
    for k, clock.now in enumerate((0.2, 0.99, 1.0, 1.5, 1.99, 2.0, 2.5, 7.0, 7.5), 1):
        checkpoints.write(replace(states[0], iterations=k), rows(k))
        if synced:
            assert synced == [FILE, f"{k:07}.npz.part", "checkpoints"]
            due.append(clock.now)
        synced.clear()
    assert due == [1.0, 2.0, 7.0]


def test_the_last_two_and_the_newest_synced_checkpoints_stay(folder: Path, states: list[State]) -> None:
    clock = Clock()
    checkpoints = Checkpoints(folder, CONFIG, clock=clock)
    stored = []
    for k, clock.now in enumerate((0.0, 0.1, 0.2, 1.0, 1.1, 1.2, 1.3, 2.1, 3.2, 3.3), 1):
        checkpoints.write(replace(states[0], iterations=k), rows(k))
        stored.append([int(name[:7]) for name in files(folder)])
    assert stored == [[1], [1, 2], [2, 3], [3, 4], [4, 5], [4, 5, 6], [4, 6, 7], [7, 8], [8, 9], [9, 10]]


def test_the_checkpoint_of_a_resumed_run_is_synced(folder: Path, states: list[State], synced: list[str]) -> None:
    write(folder, *states[:2])
    checkpoints = Checkpoints(folder, CONFIG, clock=Clock())
    checkpoints.resume_from(states[0])
    assert synced == ["0000001.npz", "checkpoints"]
    assert files(folder) == ["0000001.npz"]
    for k in (2, 3, 4, 5):
        checkpoints.write(replace(states[0], iterations=k), rows(k))
    assert files(folder) == ["0000001.npz", "0000004.npz", "0000005.npz"]


def test_an_incomplete_file_is_ignored_and_deleted(folder: Path, states: list[State]) -> None:
    (one,) = write(folder, states[0])
    for name in ("0000001.npz.part", "0000002.npz.part", "0000009.npz.part"):
        (folder / "checkpoints" / name).write_bytes(one.read_bytes())
    checkpoints = Checkpoints(folder, CONFIG)
    assert newest(folder) == 1
    checkpoints.resume_from(states[0])
    checkpoints.write(states[1], rows(2))
    assert files(folder) == ["0000001.npz", "0000002.npz"]


def test_checkpoints_contain_no_pickle(folder: Path, states: list[State]) -> None:
    (path,) = write(folder, states[0])
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)
