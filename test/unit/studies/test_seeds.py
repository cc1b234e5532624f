import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_ros.app.cli import main
from rkhs_ros.app.study import parse_seeds, seed_folders
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies.comparison import compare
from test.unit.conftest import Result, assert_refused

pytestmark = pytest.mark.slow

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
EPISODES = ("--set", "horizon=4", "episodes_per_iteration=2")
SHORT = (*EPISODES, "iterations=2")
RESULTS = ("config.yaml", "policy.npz", "curve.png", "policy.png")
Run = Callable[..., Result]


def results(folder: Path) -> dict[str, object]:
    """Return the bytes of a run's results, without the measured seconds."""
    lines = (folder / "curve.csv").read_text().splitlines()
    files: dict[str, object] = {name: (folder / name).read_bytes() for name in RESULTS}
    return files | {"curve.csv": [line.rpartition(",")[0] for line in lines]}


def times(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


# Parsing of --seeds


def test_seeds_are_the_union_of_their_ranges_in_order() -> None:
    assert parse_seeds("7, 0-3,5") == (0, 1, 2, 3, 5, 7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected seeds such as 0-9 or 0,2,5, got ''"),
        ("0,9-7", "expected ascending ranges, got 9-7"),
        ("0-10000", "expected at most 10000 seeds"),
    ],
)
def test_invalid_seeds_are_rejected(text: str, message: str) -> None:
    with pytest.raises(ValueError, match="--seeds: expected") as error:
        parse_seeds(text)
    assert message in str(error.value)


# The runs


@pytest.fixture(scope="module")
def three_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("three") / "runs"
    with pytest.raises(SystemExit, match="0"):
        main(["train", str(CONFIG), *SHORT, "--seeds", "1,10,2", "--jobs", "1", "--quiet", "--out", str(folder)])
    return folder


@pytest.fixture
def started_runs(three_runs: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(three_runs, tmp_path / "many"))


def test_each_seed_gives_an_ordinary_run(rkhs: Run, tmp_path: Path) -> None:
    code, out, err = rkhs("train", CONFIG, *SHORT, "--seeds", "0,5", "--jobs", 2, "--out", "many")
    assert code == 0
    assert err.splitlines()[-1].split()[:1] == ["toy_nac"]
    assert "2/2" in err.splitlines()[-1]
    assert [path.name for path in seed_folders(tmp_path / "many")] == ["seed_0", "seed_5"]
    for seed in (0, 5):
        alone = tmp_path / f"alone_{seed}"
        assert rkhs("train", CONFIG, *SHORT, "--runner", "inline", "--seed", seed, "--out", alone).code == 0
        assert results(tmp_path / "many" / f"seed_{seed}") == results(alone)
    (curve,) = compare([tmp_path / "many"]).curves
    assert out == f"{curve.summary()}\nCompare: rkhs compare many\n"
    assert "mean of 2 runs, 95 % interval over the seeds" in out


def test_resume_runs_only_missing_or_unfinished_seeds(rkhs: Run, started_runs: Path) -> None:
    whole = {path: results(path) for path in seed_folders(started_runs)}
    finished, unfinished, missing = seed_folders(started_runs)
    Curve(unfinished / "curve.csv").begin(Curve(unfinished / "curve.csv").rows()[:1])
    for path in missing.rglob("*"):
        if path.is_file() and path.name != "config.yaml":
            path.unlink()
    (finished / "advice.txt").write_text("give a reward with a slope\n")
    before = times(finished)
    result = rkhs("train", "--resume", "many", "--quiet", "--jobs", 1)
    assert (result.code, result.err) == (0, "")
    assert "\nseed_1: give a reward with a slope\n" in result.out
    assert {path: results(path) for path in seed_folders(started_runs)} == whole
    assert times(finished) == before
    assert rkhs("train", "--resume", "many", "--iterations", 3, "--quiet", "--jobs", 1).code == 0
    assert [len(Curve(path / "curve.csv").rows()) for path in seed_folders(started_runs)] == [3] * 3


CALLS = """import time
from rkhs_ros.studies.workers import run_parallel
try:
    list(run_parallel(time.sleep, [(60,)] * 9, jobs=2, title="calls", quiet=True))
except KeyboardInterrupt:
    print("interrupted")
"""


def in_a_terminal(command: list[str]) -> subprocess.Popen[str]:
    """Start a command that receives signals together with its processes."""
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True)


def test_workers_that_start_while_the_user_interrupts_print_nothing() -> None:
    process = in_a_terminal([sys.executable, "-c", CALLS])
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not any("umath" in Path(f"/proc/{pid}/maps").read_text() for pid in children.read_text().split()):
        assert process.poll() is None  # until a worker imports numpy
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=120) == ("interrupted\n", "")


@pytest.mark.nightly
@pytest.mark.slow
def test_interrupted_training_with_several_seeds_resumes(rkhs: Run, tmp_path: Path) -> None:
    many, whole = tmp_path / "many", tmp_path / "whole"
    long = (*EPISODES, "iterations=30", "--seeds", "0-5", "--quiet")
    command = [sys.executable, "-m", "rkhs_ros.app.cli", "train", CONFIG, *long, "--out", many, "--jobs", "2"]
    process = in_a_terminal([*map(str, command)])
    while not list(many.glob("seed_*/recording.mcap")):
        assert process.poll() is None
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (130, "")
    assert err == f"interrupted; resume with: rkhs train --resume {many}\n"
    assert rkhs("train", "--resume", many, "--quiet", "--jobs", 1).code == 0
    assert rkhs("train", CONFIG, *long, "--out", whole, "--jobs", 1).code == 0
    assert [results(path) for path in seed_folders(many)] == [results(path) for path in seed_folders(whole)]


# Invalid options


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--seeds", "0-1", "--runner", "ros"), "--runner: expected inline for several seeds, got ros"),
        (("--seeds", "0-1", "--jobs", "0"), "--jobs: expected at least 1, or tcp://HOST:PORT, got 0"),
        (("--jobs", "2"), "--jobs: expected --seeds, or --resume of runs with several seeds, got one run"),
        (("--seeds", "0-1", "--set", "exploration_sd=[1, 2]"), "exploration_sd: expected 1 number, got 2"),
    ],
)
def test_invalid_options_are_rejected_once_and_nothing_starts(
    rkhs: Run, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert_refused(rkhs("train", CONFIG, *arguments), message)
    assert list(tmp_path.iterdir()) == []
