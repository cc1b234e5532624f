import csv
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from rkhs_ros.app.cli import main
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.learning.iteration import Row
from rkhs_ros.runs.curve import BEGINNING, Curve
from rkhs_ros.studies.grid import outcome, parse_variations, points
from rkhs_ros.studies.workers import WorkerLostError, run_parallel
from test.unit.conftest import Result, assert_refused

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
TINY = ("--set", "horizon=4", "iterations=3", "episodes_per_iteration=2", "evaluation_episodes=2")
GRID = ("--vary", "algorithm.ridge=1e-3,1e-2", "kernel.bandwidth_scale=1,2", "--seeds", "0-1", "--jobs", 1, "--quiet")
Run = Callable[..., Result]
NAN = float("nan")


@given(
    st.dictionaries(
        st.sampled_from(["a", "b.c", "d"]), st.lists(st.integers(-9, 9), min_size=1, unique=True), min_size=1
    )
)
def test_a_grid_has_each_combination_once(values: dict[str, list[int]]) -> None:
    varied = parse_variations(f"{name}={','.join(map(str, numbers))}" for name, numbers in values.items())
    made = [tuple(loaded(change.partition("=")[2]) for change in point) for point in points(varied)]
    expected = 1
    for numbers in values.values():
        expected *= len(numbers)
    assert len(set(made)) == len(made) == expected
    assert all(value in numbers for point in made for value, numbers in zip(point, values.values(), strict=True))


def test_values_are_yaml_so_that_lists_and_words_can_be_varied() -> None:
    assert parse_variations(["exploration_sd=range, [1, 2],0.5"]) == {"exploration_sd": ["range", [1, 2], 0.5]}


def row(episodes: int, value: float) -> Row:
    return BEGINNING._replace(episodes=episodes, evaluation_episodes=2, evaluation_return=value)


def test_an_outcome_has_final_and_best_return_and_episodes_to_thresholds() -> None:
    rows = [row(2, 1.0), row(4, NAN), row(6, 5.0), row(8, 2.0), row(10, NAN)]
    expected = {"final_return": 2.0, "best_return": 5.0, "episodes_to_2": 6.0, "episodes_to_5": 6.0}
    assert outcome(rows, (2.0, 5.0, 5.1)) == expected | {"episodes_to_5.1": float("inf")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "grid"
    with pytest.raises(SystemExit, match="0"):
        main([*map(str, ("sweep", CONFIG, *GRID, *TINY, "--thresholds", "0", "--out", folder))])
    return folder


@pytest.fixture
def swept(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "grid"))


def lines(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.open()))


@pytest.mark.slow
def test_each_run_of_a_grid_equals_an_ordinary_run(rkhs: Run, swept: Path, tmp_path: Path) -> None:
    runs = lines(swept / "runs.csv")
    assert len(runs) == len({each["folder"] for each in runs}) == 8
    last = runs[-1]
    setting = [f"{name}={last[name]}" for name in ("algorithm.ridge", "kernel.bandwidth_scale")]
    assert [*setting, last["seed"]] == ["algorithm.ridge=0.01", "kernel.bandwidth_scale=2", "1"]
    assert rkhs("train", CONFIG, "--runner", "inline", *TINY, *setting, "--seed", 1, "--out", "alone").code == 0
    returns = [each.evaluation_return for each in Curve(tmp_path / "alone" / "curve.csv").rows()]
    assert (float(last["final_return"]), float(last["best_return"])) == (returns[-1], max(returns))
    assert last["episodes_to_0"] == "2.0"
    medians = lines(swept / "medians.csv")
    assert [each["runs"] for each in medians] == ["2"] * 4
    finals = [float(each["final_return"]) for each in medians]
    assert finals == sorted(finals, reverse=True)
    assert (swept / "comparison.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_a_sweep_continues_and_a_larger_one_runs_only_new_points(rkhs: Run, swept: Path) -> None:
    whole = (swept / "runs.csv").read_bytes()
    cut, *finished = sorted((swept / "runs").iterdir())
    Curve(cut / "curve.csv").begin(Curve(cut / "curve.csv").rows()[:1])
    (cut / "policy.npz").unlink()
    times = [(path / "policy.npz").stat().st_mtime_ns for path in finished]
    larger = [str(word).replace("0-1", "0-2") for word in GRID]
    assert rkhs("sweep", CONFIG, *larger, *TINY, "--thresholds", "0", "--out", "grid").code == 0
    assert len(list((swept / "runs").iterdir())) == 12
    assert set(whole.splitlines()) < set((swept / "runs.csv").read_bytes().splitlines())
    assert [(path / "policy.npz").stat().st_mtime_ns for path in finished] == times


@pytest.mark.slow
def test_a_failed_run_is_reported_and_the_others_are_tabulated(rkhs: Run, swept: Path) -> None:
    bad = min((swept / "runs").iterdir())
    (bad / "recording.mcap").write_bytes(b"damaged")
    (bad / "policy.npz").unlink()
    code, _, err = rkhs("sweep", CONFIG, *GRID, *TINY, "--out", "grid")
    assert code == 1
    assert err.startswith(f"error: {bad.name}: ")
    assert len(lines(swept / "runs.csv")) == 7


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--vary", "algorithm.rigde=1,2"), "unknown key 'algorithm.rigde', did you mean 'algorithm.ridge'?"),
        (("--vary", "algorithm.ridge"), "--vary: expected KEY=VALUE,VALUE ..., got 'algorithm.ridge'"),
        (("--vary", "algorithm.ridge=0.1,1e-1"), "--vary: algorithm.ridge: expected distinct values"),
        (("--vary", "algorithm.ridge=1,2", "--out", "/proc"), "/proc: expected a new or empty folder, or that of"),
        (("--vary", "environment.id=a,b"), "--vary: expected settings that do not change the task"),
        (("--vary", "evaluate_every=0,1"), "evaluate_every: expected 1 to 40, since results need evaluations, got 0"),
    ],
)
def test_invalid_options_are_rejected_once_and_nothing_starts(
    rkhs: Run, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert_refused(rkhs("sweep", CONFIG, *arguments), message)
    assert list(tmp_path.iterdir()) == []


def ended_by_signal(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.slow
def test_killed_processes_are_reported() -> None:
    with pytest.raises(WorkerLostError, match="run the same command to continue"):
        list(run_parallel(ended_by_signal, [(number,) for number in range(4)], jobs=2, title="calls", quiet=True))
