import resource
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.base.files import locked
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.policies.storage import unpacked
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs import report
from rkhs_ros.runs.config import Config, Environment, load_config
from rkhs_ros.runs.curve import BEGINNING, Curve
from rkhs_ros.runs.run import run_training
from rkhs_ros.view.recorded import Recorded
from test.unit.conftest import Result, assert_refused, model_free
from test.unit.runs.stopping import Stopping

pytestmark = pytest.mark.slow

CONFIG_FILE = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
TRAINING = model_free(name="short", iterations=4, episodes_per_iteration=2, evaluation_episodes=1, horizon=4)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TRAINING)
RESULTS = ("best_policy.npz", "config.yaml", "curve.csv", "final_evaluation.txt", "policy.npz")
DRAWN = {"curve.png", "policy.png"}  # by the command
INLINE = ("--runner", "inline", "--quiet")

Cli = Callable[..., Result]


def longer(iterations: int, **changes: Any) -> Config:
    return replace(CONFIG, training=replace(TRAINING, iterations=iterations, **changes))


def stopped(folder: Path, batches: int, config: Config = CONFIG) -> Path:
    with pytest.raises(KeyboardInterrupt):
        run_training(config, Stopping(batches), folder, quiet=True)
    return folder


def resumed(folder: Path, config: Config = CONFIG) -> Path:
    return run_training(config, Stopping(), folder, quiet=True, resume=True)


def results(folder: Path) -> dict[str, object]:
    """Return the bytes of a run's results, without the measured seconds."""
    assert {path.name for path in folder.iterdir()} - DRAWN == {*RESULTS, "lock", "recording.mcap"}
    found: dict[str, object] = {name: (folder / name).read_bytes() for name in RESULTS}
    lines = (folder / "curve.csv").read_text().splitlines()
    found["curve.csv"] = [line.rpartition(",")[0] for line in lines]
    return found


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    return results(run_training(CONFIG, Stopping(), tmp_path_factory.mktemp("whole") / "run", quiet=True))


@pytest.mark.parametrize("batches", [0, 4])
def test_a_run_stopped_anywhere_resumes_bit_identically(tmp_path: Path, whole: dict[str, object], batches: int) -> None:
    folder = stopped(tmp_path / "run", batches)
    assert len(Curve(folder / "curve.csv").rows()) == batches // 2
    left = Stopping(8 - batches // 2 * 2)  # no finished iteration is repeated
    assert results(run_training(CONFIG, left, folder, quiet=True, resume=True)) == whole


def test_a_run_with_a_model_resumes_the_policy_that_explores_as_well_as_the_recommended_one(tmp_path: Path) -> None:
    model = ModelBased(updates=5, rollouts=4, centres=30, discovery="none")
    training = replace(TRAINING, iterations=5, horizon=6, model=model)
    for seed in range(20):  # in which of them the two policies differ depends on rounding
        config = replace(CONFIG, training=replace(training, seed=seed))
        whole = run_training(config, Stopping(), tmp_path / f"whole{seed}", quiet=True)
        update = read_recording(whole / "recording.mcap").updates[2]
        if update.policy_version != update.explorer_version:
            break
    assert update.policy_version != update.explorer_version
    assert results(resumed(stopped(tmp_path / "run", 6, config), config)) == results(whole)


def test_a_finished_run_repeats_its_last_iteration(tmp_path: Path, whole: dict[str, object]) -> None:
    folder = run_training(CONFIG, Stopping(), tmp_path / "run", quiet=True)
    (folder / "policy.npz").unlink()  # like a run that is killed before its end
    run_training(CONFIG, Stopping(2), folder, quiet=True, resume=True)
    assert results(folder) == whole


def test_an_extended_run_equals_a_run_with_more_iterations(tmp_path: Path) -> None:
    folder = run_training(CONFIG, Stopping(), tmp_path / "run", quiet=True)
    more = longer(6, timeout=1.0)
    assert results(resumed(folder, more)) == results(run_training(more, Stopping(), tmp_path / "more", quiet=True))
    assert load_config(folder / "config.yaml") == more


def test_a_run_without_its_recording_is_rejected_and_unchanged(rkhs: Cli, tmp_path: Path) -> None:
    folder = stopped(tmp_path / "run", 6)
    (folder / "recording.mcap").unlink()
    before = contents(folder)
    expected = "expected the recording of curve.csv, policy.npz, got none"
    assert_refused(rkhs("train", "--resume", "run", *INLINE), f"run/recording.mcap: {expected}")
    assert contents(folder) == before


def test_a_run_resumes_from_the_intact_part_of_its_recording(
    tmp_path: Path, whole: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    file = stopped(tmp_path / "run", 6) / "recording.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert results(resumed(file.parent)) == whole
    assert "recording.mcap: " in capsys.readouterr().err


def test_a_rejected_resume_changes_nothing(tmp_path: Path) -> None:
    folder = stopped(tmp_path / "run", 5)
    before = contents(folder)
    for config, message in (
        (longer(6, seed=1), "seed: expected 0 as at the start of the run, got 1"),
        (longer(6, algorithm=ALGORITHMS["power"]()), "algorithm.name: expected rkhs_nac as .* got power"),
        (replace(CONFIG, environment=Environment("rkhs/Toy-v0", {"start": 1})), "start: expected no such setting as"),
        (longer(1), "iterations: expected at least 2, the finished ones, got 1"),
    ):
        with pytest.raises(ValueError, match=message):
            resumed(folder, config)
    assert contents(folder) == before
    for no_run in (None, tmp_path / "none", tmp_path):
        with pytest.raises(ValueError, match=r"expected the folder of a run, got (none|no such folder)"):
            run_training(CONFIG, Stopping(), no_run, quiet=True, resume=True)
    assert list(tmp_path.iterdir()) == [folder]


ROWS = [
    BEGINNING._replace(
        iteration=k, episodes=3 * k, exploration_return=-1.5 / k, evaluation_return=1e17 * k, seconds=k / 4
    )
    for k in (1, 2, 3)
]


@pytest.mark.parametrize("content", [None, b"iteration,episodes\r\n1,99\r\n"])
def test_the_curve_is_derived_from_the_recording(
    tmp_path: Path, whole: dict[str, object], content: bytes | None
) -> None:
    folder = stopped(tmp_path / "run", 6)
    (folder / "curve.csv").unlink()
    if content is not None:
        (folder / "curve.csv").write_bytes(content)
    assert results(resumed(folder)) == whole


@pytest.mark.usefixtures("quick_disk")
def test_a_curve_truncated_at_any_byte_has_its_complete_lines(tmp_path: Path) -> None:
    curve = Curve(tmp_path / "curve.csv")
    assert curve.rows() == []
    curve.begin(ROWS[:1])
    for row in ROWS[1:]:
        curve.append(row)
    whole = curve.path.read_bytes()
    assert whole.count(b"\r\n") == 4
    for length in range(len(whole) + 1):
        curve.path.write_bytes(whole[:length])
        rows = curve.rows()
        assert len(rows) == max(whole[:length].count(b"\r\n") - 1, 0)
        assert str(rows) == str(ROWS[: len(rows)])
        curve.begin(rows[:2])
        assert curve.path.read_bytes() == b"".join(whole.splitlines(keepends=True)[: min(len(rows), 2) + 1])


def test_a_run_resumes_with_other_versions_and_records_them(
    rkhs: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = InlineRunner(Simulation("rkhs/Toy-v0"))
    folder = run_training(longer(2), runner, tmp_path / "run", quiet=True)
    monkeypatch.setattr(report, "LIBRARIES", {**report.LIBRARIES, "numpy": "1.2.3"})
    code, _, err = rkhs("train", "--resume", "run", *INLINE, "--iterations", 4)
    before = f"warning: run/recording.mcap: begun with numpy {np.__version__}, resumed with numpy 1.2.3; "
    assert (code, err) == (0, f"{before}the results may differ from those of an uninterrupted run\n")
    assert "numpy 1.2.3, " in (folder / "config.yaml").read_text().splitlines()[0]
    first, second = read_recording(folder).heads
    assert first.versions != second.versions
    assert "numpy 1.2.3" in second.versions
    assert rkhs("train", "--resume", "run", *INLINE, "--iterations", 5)[::2] == (0, "")  # only a change is reported
    assert rkhs("replay", "run", "--quiet").out == "all 5 updates are bit-identical\n"
    assert [row.iteration for row in Recorded(folder).rows] == [1, 2, 3, 4, 5]


@pytest.fixture
def disk() -> Iterator[Callable[[int], None]]:
    """Limit the size of files like a full disk, until the end of the test."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (soft if size < 0 else size, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def assert_whole(folder: Path) -> None:
    """Assert that no file under its final name is incomplete."""
    assert not list(folder.rglob("*.part"))
    for path in folder.rglob("*.npz"):
        assert unpacked(path.read_bytes())
    for path in folder.glob("*.png"):
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
    for path in folder.glob("config.yaml"):
        assert load_config(path)


def test_a_run_on_a_full_disk_ends_with_one_line_and_resumes_later(
    rkhs: Cli, tmp_path: Path, disk: Callable[[int], None]
) -> None:
    arguments = ("train", CONFIG_FILE, *INLINE, "--iterations", 12, "--set", "horizon=5")
    assert rkhs(*arguments, "--out", "whole")[0] == 0
    disk((tmp_path / "whole" / "recording.mcap").stat().st_size // 2)
    code, out, err = rkhs(*arguments, "--out", "run")
    disk(-1)
    assert (code, out) == (1, "")
    assert err.startswith("error: run/recording.mcap: file too large\ninterrupted after ")
    assert_whole(tmp_path / "run")
    assert rkhs("train", "--resume", "run", *INLINE)[::2] == (0, "")
    assert results(tmp_path / "run") == results(tmp_path / "whole")


def test_the_command_resumes_a_run(rkhs: Cli, tmp_path: Path, whole: dict[str, object]) -> None:
    stopped(tmp_path / "run", 5)
    code, out, err = rkhs("train", "--resume", "run", *INLINE)
    assert (code, err) == (0, "")
    assert out.startswith("Trained on rkhs/Toy-v0 for 8 episodes")
    assert results(tmp_path / "run") == whole
    assert rkhs("train", "--resume", "run", *INLINE, "--iterations", 5)[0] == 0
    assert load_config(tmp_path / "run" / "config.yaml") == longer(5)
    assert len(Curve(tmp_path / "run" / "curve.csv").rows()) == 5


def test_a_folder_is_locked_during_a_run_only(rkhs: Cli, tmp_path: Path) -> None:
    folder = stopped(tmp_path / "run", 5)
    before = contents(folder)
    with locked(folder):
        assert_refused(rkhs("train", "--resume", "run", *INLINE), "in use by another process")
        assert contents(folder) == before
    assert rkhs("train", "--resume", "run", *INLINE)[0] == 0


@pytest.mark.parametrize("from_start", [True, False])
def test_tensorboard_reads_each_row_once_after_a_resume(from_start: bool, tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    with pytest.raises(KeyboardInterrupt):
        run_training(CONFIG, Stopping(5), tmp_path, quiet=True, tensorboard=from_start)
    run_training(CONFIG, Stopping(), tmp_path, quiet=True, resume=True, tensorboard=not from_start)
    read = reader.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    rows = Curve(tmp_path / "curve.csv").rows()
    for name in read.Tags()["scalars"]:
        expected = [(row.iteration, np.float32(getattr(row, name))) for row in rows if isfinite(getattr(row, name))]
        assert [(scalar.step, scalar.value) for scalar in read.Scalars(name)] == expected


def test_a_missing_package_is_reported_before_the_run(
    rkhs: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rkhs_ros.base.validation.find_spec", lambda name: None)
    expected = "--tensorboard: expected tensorboardX to be installed"
    assert_refused(rkhs("train", CONFIG_FILE, "--tensorboard", "--out", "run"), expected)
    assert not (tmp_path / "run").exists()
