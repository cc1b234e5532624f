import csv
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.state import first_policy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.curve import BEGINNING, Curve
from rkhs_ros.runs.report import resolved, start_from
from rkhs_ros.studies.aggregates import aggregates, mean_over_runs
from rkhs_ros.studies.comparison import compare
from test.unit.conftest import Result, model_free

pytestmark = pytest.mark.slow

Run = Callable[..., Result]


def run_folder(
    folder: Path, returns: Sequence[float], *, train: float = -1.0, per_iteration: int = 10, **settings: Any
) -> Path:
    """Write the configuration and the curve of a run."""
    training = model_free(**{"horizon": 20, "iterations": len(returns) or 1, **settings})
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(resolved(Config(Environment("rkhs/Toy-v0", {}), training)))
    rows = []
    for k, value in enumerate(returns, start=1):
        counts = {"iteration": k, "episodes": k * per_iteration, "steps": 20 * k * per_iteration}
        rows.append(BEGINNING._replace(**counts, exploration_return=train, evaluation_return=value))
    Curve(folder / "curve.csv").begin(rows)
    return folder


def test_a_curve_of_exchanged_lines_is_refused(tmp_path: Path) -> None:
    curve = Curve(run_folder(tmp_path / "run", [1.0, 2.0]) / "curve.csv")
    curve.begin(curve.rows()[::-1])
    with pytest.raises(ValueError, match=r"curve.csv: expected \d+ numbers of iteration 1 in line 2, got '2,"):
        curve.rows()


# Statistics


@pytest.mark.parametrize("runs", [4, 7])
def test_aggregates_match_an_independent_computation(runs: int) -> None:
    returns = np.random.default_rng(1).gamma(2.0, 3.0, (runs, 5))
    episodes = np.array([5.0, 10.0, 30.0, 40.0, 80.0])
    found = aggregates(episodes, returns)
    final, cut = np.sort(returns[:, -1]), runs // 4
    assert found["final"].value == pytest.approx(sum(final) / runs)
    assert found["best"].value == pytest.approx(sum(max(row) for row in returns.tolist()) / runs)
    assert found["interquartile_mean"].value == pytest.approx(sum(final[cut : runs - cut]) / (runs - 2 * cut))
    assert found["median"] == pytest.approx((final[(runs - 1) // 2] + final[runs // 2]) / 2)
    areas = [
        sum((row[k] + row[k + 1]) / 2 * (episodes[k + 1] - episodes[k]) for k in range(4)) / 75.0
        for row in returns.tolist()
    ]
    assert found["area_under_curve"] == pytest.approx(sum(areas) / runs)


def test_intervals_are_percentiles_of_bootstrap_means() -> None:
    final = np.random.default_rng(2).gamma(2.0, 3.0, 12)
    drawn = np.random.default_rng(3).choice(final, (40_000, 12))
    low, high = np.percentile(drawn.mean(axis=1), [2.5, 97.5])
    estimate = mean_over_runs(final)
    assert (estimate.low, estimate.high) == pytest.approx((low, high), abs=0.05 * (high - low))
    middle = np.sort(drawn, axis=1)[:, 3:9].mean(axis=1)
    estimate = aggregates(np.arange(1.0), final[:, None])["interquartile_mean"]
    low, high = np.percentile(middle, [2.5, 97.5])
    assert (estimate.low, estimate.high) == pytest.approx((low, high), abs=0.05 * (high - low))


# Selection of runs


def test_runs_that_differ_only_in_seed_and_name_form_one_curve(tmp_path: Path) -> None:
    for seed in range(3):
        run_folder(tmp_path / "nac" / f"seed_{seed}", [1.0 + seed, 2.0 + seed], seed=seed, name=f"n{seed}")
    other = run_folder(tmp_path / "other", [5.0, 6.0], algorithm=ALGORITHMS["rkhs_power"]())
    nac, power = compare([tmp_path / "nac", other]).curves
    assert (nac.label, power.label) == ("rkhs_nac", "rkhs_power")
    np.testing.assert_array_equal(nac.returns, [[1.0, 2.0], [2.0, 3.0], [3.0, 4.0]])
    np.testing.assert_array_equal(nac.episodes, [10.0, 20.0])
    np.testing.assert_array_equal(power.returns, [[5.0, 6.0]])


def test_runs_with_different_initial_policies_form_different_curves(tmp_path: Path) -> None:
    training = model_free(horizon=20, iterations=1)
    config = Config(Environment("rkhs/Toy-v0", {}), training)
    spaces = Spaces.unbounded(1, 1)
    policy = first_policy(training, spaces)
    for name in ("default", "given"):
        run_folder(tmp_path / name, [1.0])
    start_from(tmp_path / "given", config, policy, spaces)
    assert [c.label for c in compare([tmp_path / "default", tmp_path / "given"]).curves] == ["default", "given"]


def test_longer_runs_are_truncated_with_a_note(tmp_path: Path) -> None:
    folders = [
        run_folder(tmp_path / "long", [1.0, 2.0, 3.0, 9.0], per_iteration=10),
        run_folder(tmp_path / "slow", [4.0] * 5, per_iteration=5),
    ]
    comparison = compare(folders)
    assert [c.episodes[-1] for c in comparison.curves] == [20.0, 25.0]
    np.testing.assert_array_equal(comparison.curves[0].returns, [[1.0, 2.0]])
    note, areas = comparison.notes
    assert areas.startswith("The areas under the curves are not comparable")
    assert note == f"Compared up to exploration episode 25, the end of the shortest run: {tmp_path / 'slow'}."
    assert note in str(comparison)


def test_runs_without_common_episodes_are_omitted_with_a_note_so_that_most_remain(tmp_path: Path) -> None:
    short = run_folder(tmp_path / "short", [1.0, 2.0], per_iteration=1, algorithm=ALGORITHMS["rkhs_nac"](ridge=0.5))
    long = [run_folder(tmp_path / f"{seed}", [3.0, 4.0], per_iteration=8, seed=seed) for seed in range(2)]
    comparison = compare([short, *long])
    assert [curve.returns.tolist() for curve in comparison.curves] == [[[3.0, 4.0]] * 2]
    assert comparison.notes == (f"Omitted, since it does not span episode 8: {short}.",)
    late = run_folder(tmp_path / "late", [3.0], per_iteration=80, algorithm=ALGORITHMS["rkhs_nac"](ridge=0.5))
    assert compare([*long, late]).notes == (f"Omitted, since it does not span episode 8: {late}.",)


def test_without_evaluations_curves_show_exploration_returns_with_a_note(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "r", [float("nan")] * 2, train=7.0)
    comparison = compare([folder])
    np.testing.assert_array_equal(comparison.curves[0].returns, [[7.0, 7.0]])
    assert not comparison.curves[0].is_evaluation
    assert comparison.notes == ("rkhs_nac: no evaluation; shows the exploration return.",)
    assert "exploration return 7 after 20 episodes (400 steps)" in comparison.curves[0].summary()


def test_runs_without_an_iteration_are_omitted_with_a_note(tmp_path: Path) -> None:
    run_folder(tmp_path / "r" / "a", [1.0])
    empty = run_folder(tmp_path / "r" / "b", [], seed=1)
    comparison = compare([tmp_path / "r"])
    assert comparison.curves[0].returns.shape == (1, 1)
    assert comparison.notes == (f"Omitted, since it has no finished iteration: {empty}.",)
    without_curve = shutil.copytree(empty, tmp_path / "r" / "c", ignore=lambda *_: ["curve.csv"])
    (without_curve / "config.yaml").write_text("of: another program\n")
    assert compare([tmp_path / "r"]).notes == tuple(
        f"Omitted, since it has no finished iteration: {each}." for each in (empty, without_curve)
    )
    with pytest.raises(ValueError, match=r"^compare: expected at least one run's folder, got none$"):
        compare([])
    with pytest.raises(ValueError, match="r/b: expected a run with at least one iteration, got none"):
        compare([empty])
    with pytest.raises(ValueError, match=r"^labels: expected a label of .*r/a, got .*r/b"):
        compare([tmp_path / "r"], {empty: "b"})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "b: expected settings or a seed that no other run has, got those of .*a"),
        ({"discount": 0.9}, "b: discount: expected 0.99 like .*a, got 0.9"),
        ({"horizon": 9}, "b: horizon: expected 20 like .*a, got 9"),
    ],
)
def test_incomparable_runs_are_rejected(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    for name, more in (("a", {}), ("b", settings)):
        run_folder(tmp_path / name, [1.0], **more)
    with pytest.raises(ValueError, match=message):
        compare([tmp_path / "a", tmp_path / "b"])


# The command


def test_the_command_writes_picture_and_tables_and_prints_the_table(rkhs: Run, tmp_path: Path) -> None:
    for seed in range(4):
        run_folder(tmp_path / "a" / f"seed_{seed}", [1.0, 2.0 + seed], seed=seed)
    run_folder(tmp_path / "b|b", [1.5, 2.5], algorithm=ALGORITHMS["rkhs_nac"](ridge=0.5))
    code, out, err = rkhs("compare", "a", "b|b", "--out", "made/here.png")
    assert (code, err) == (0, "")
    assert {path.name for path in (tmp_path / "made").iterdir()} == {"here.png", "here.csv", "here.md"}
    assert out.startswith((tmp_path / "made" / "here.md").read_text())
    header, _, first, second, *_ = out.splitlines()
    assert [name.strip() for name in header.split("|")[1:4]] == ["curve", "kind", "runs"]
    assert first.startswith("| a     | evaluation | 4    | 20       | 400   | 3.5 [2.5, 4.5]")
    assert second.startswith(r"| b\|b  | evaluation | 1    | 20       | 400   | 2.5 ")
    lines = list(csv.DictReader((tmp_path / "made" / "here.csv").open()))
    assert [line["curve"] for line in lines] == ["a", "b|b"]
    names = ("runs", "final", "final_low", "final_high", "best", "median")
    assert [lines[0][name] for name in names] == ["4", "3.5", "2.5", "4.5", "3.5", "3.5"]
    assert lines[1]["interquartile_mean_low"] == ""
    again = (tmp_path / "made" / "here.png").read_bytes()
    rkhs("compare", "a", "b|b", "--out", "made/here.png")
    assert (tmp_path / "made" / "here.png").read_bytes() == again
