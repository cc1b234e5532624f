"""The progress bar of a run shows the remaining time, and appears once on a terminal, even after Ctrl-C."""

from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from rkhs_ros.learning.iteration import Row, with_error
from rkhs_ros.learning.training import train
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs import progress
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import BEGINNING, seconds_left
from rkhs_ros.runs.progress import ECHO, progress_bar
from test.unit.conftest import model_free

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
COLUMNS = 80


def lines_on_terminal(text: str) -> list[str]:
    """Return the lines that a terminal shows: without escapes, with carriage returns applied."""
    plain = "".join(part[part.find("m") + 1 :] if k else part for k, part in enumerate(text.split("\x1b[")))
    return [line.rpartition("\r")[2] for line in plain.replace("\r\n", "\n").splitlines()]


def test_name_bar_iteration_times_and_returns_of_a_run_with_a_model_fit_80_columns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = StringIO()
    console = Console(file=out, force_terminal=True, color_system=None, width=COLUMNS - len(ECHO) - 1)
    monkeypatch.setattr(progress, "bar_console", lambda *, quiet: console)
    training = model_free(name="n" * 40, iterations=300, episodes_per_iteration=2, evaluation_episodes=1, horizon=4)
    (iteration,) = train(replace(training, iterations=1), InlineRunner(Simulation("rkhs/Toy-v0")))
    with progress_bar(training, done=298) as show:
        show(replace(iteration, model_return=-1234.5, model_error=0.0123))
    bar, returns = lines_on_terminal(out.getvalue().rpartition("\x1b[2K")[2])[:2]
    assert "…" in bar  # only the name is cut
    assert "━━━━━━━━━" in bar
    assert "299/300" in bar
    assert bar.count(":") == 4  # the elapsed and the remaining time
    assert returns.startswith("returns: exploration ")
    assert returns.endswith(", model -1234 (error 0.012)")


@pytest.mark.parametrize(("period", "numbers"), [(0.0, ["1", "2", "3", "4"]), (1000.0, ["1", "4"])])
def test_without_a_terminal_lines_appear_periodically_and_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, period: float, numbers: list[str]
) -> None:
    monkeypatch.setattr(progress, "LINE_PERIOD_S", period)
    config = load_config(CONFIG, ["iterations=4", "episodes_per_iteration=2"])
    with progress_bar(config.training) as show:
        for iteration in train(config.training, InlineRunner(Simulation("rkhs/Toy-v0"))):
            show(iteration)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert [line.split()[2] for line in lines] == numbers
    evaluation = with_error(iteration.evaluation_return, iteration.evaluation_return_sd / 3)  # of 10 episodes
    returns = f"exploration {iteration.exploration_return:.4g}, evaluation {evaluation}"
    assert f"toy_nac: iteration 4 of 4, returns: {returns}" in lines[-1]


def test_the_remaining_time_follows_from_the_last_iterations() -> None:
    def rows(seconds: list[float]) -> list[Row]:
        return [BEGINNING._replace(iteration=i + 1, seconds=s) for i, s in enumerate(seconds)]

    assert np.isnan(seconds_left([], 10))
    assert np.isnan(seconds_left(rows([1.0]), 10))
    assert seconds_left(rows([1.0, 3.0]), 10) == 16.0
    slow_at_first = [100.0 * i for i in range(30)] + [2900.0 + 0.5 * i for i in range(1, 21)]
    assert seconds_left(rows(slow_at_first), 70) == pytest.approx(10.0)
