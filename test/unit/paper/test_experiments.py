import csv
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.app.study import make_missing
from rkhs_ros.learning.training import train
from rkhs_ros.paper.experiment import Curve, Experiment, known, load_experiment
from rkhs_ros.paper.reproduce import Table, reproduce
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation

ROOT = Path(__file__).parents[3]
SHORT = ("iterations=2", "horizon=5", "episodes_per_iteration=2", "evaluation_episodes=2")
PAPER_RUNS = {"fig1": 50, "fig2": 50, "fig3-toy": 50, "fig3-pendulum": 15, "fig5-pomdp": 10, "fig5-pr2": 5}


def make_table(experiment: Experiment, out: Path, *, runs: int, jobs: int = 1) -> Table:
    make = partial(make_missing, jobs=jobs, title="small", quiet=True)
    return reproduce(experiment, out, make, runs=runs)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    nac, ac = (Curve(name, ROOT / "config" / f"toy_{name}.yaml", SHORT) for name in ("nac", "ac"))
    longer = replace(nac, label="longer", changes=(*SHORT, "iterations=3"))
    return Experiment("small", "Small", 2, "sd", {"left": (nac, ac), "right": (longer,)})


def test_the_papers_figures_are_defined_with_its_numbers_of_runs() -> None:
    assert {name: load_experiment(name).runs for name in known()} == PAPER_RUNS


@pytest.mark.parametrize("name", PAPER_RUNS)
def test_every_curve_of_a_figure_has_a_distinct_configuration(name: str) -> None:
    curves = [curve for panel in load_experiment(name).panels.values() for curve in panel]
    settings = [str(curve.run(3).parameters()) for curve in curves]
    assert len(set(settings)) == len(curves)
    assert all(curve.run(3).training.seed == 3 for curve in curves)


@pytest.mark.slow
def test_a_table_contains_every_iteration_of_every_run(experiment: Experiment, tmp_path: Path) -> None:
    table = make_table(experiment, tmp_path, runs=2)
    lines = list(csv.DictReader((tmp_path / "small.csv").open()))
    assert len(lines) == 2 * (2 + 2 + 3)
    last = [row.evaluation_return for row in table["right", "longer"][1]]
    assert [float(line["evaluation_return"]) for line in lines[-3:]] == pytest.approx(last, abs=5e-4)
    config = experiment.panels["left"][1].run(1)
    runner = InlineRunner(Simulation(config.environment.id))
    expected = [iteration.evaluation_returns.mean() for iteration in train(config.training, runner)]
    assert [(row.evaluation_return, row.episodes) for row in table["left", "ac"][1]] == list(
        zip(expected, (2, 4), strict=True)
    )


@pytest.mark.parametrize("name", PAPER_RUNS)
def test_the_page_of_results_has_the_returns_of_the_figures(name: str) -> None:
    section = (ROOT / "docs" / "results.md").read_text().split(f"\n## {name}\n")[1].split("\n## ")[0]
    table = (line.strip("|").split("|") for line in section.splitlines() if line.startswith("| "))
    rows = [[cell.strip() for cell in line] for line in table][1:]
    for above, row in pairwise(rows):
        row[0] = row[0] or above[0]  # an empty cell repeats the one above
    final: dict[tuple[str, str], dict[str, float]] = {}
    for line in csv.DictReader((ROOT / "docs" / "results" / f"{name}.csv").open()):
        final.setdefault((line["panel"], line["curve"]), {})[line["run"]] = float(line["evaluation_return"])
    lasts = {key: np.array(list(each.values())) for key, each in final.items()}
    width = len(rows[0]) - 3  # a figure with one plot has no column of it
    assert {tuple(row[:width]): tuple(row[width:]) for row in rows} == {
        key[-width:]: tuple(f"{value:.2f}" for value in (last.mean(), last.min(), last.std()))
        for key, last in lasts.items()
    }
