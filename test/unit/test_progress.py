"""What is shown of a run where there is no terminal."""

from pathlib import Path

import pytest

from rkhs_ros.app.inline import iterations
from rkhs_ros.runs import progress
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.progress import progress_bar

TOY = Path(__file__).parents[2] / "config" / "toy_nac.yaml"


@pytest.mark.parametrize(("period", "numbers"), [(0.0, ["1", "2", "3", "4"]), (1000.0, ["1", "4"])])
def test_without_a_terminal_a_line_comes_every_few_seconds_and_with_the_last_iteration(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, period: float, numbers: list[str]
) -> None:
    monkeypatch.setattr(progress, "LINE_PERIOD_S", period)
    config = load_config(TOY, ["iterations=4", "episodes_per_iteration=2"])
    with progress_bar(config.training) as show:
        returns = []
        for iteration in iterations(config):
            show(iteration)
            returns.append(iteration.train_return)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert [line.split()[2] for line in lines] == numbers
    assert f"toy_nac: iteration 4 of 4, return {returns[-1]:.2f}, noise-free " in lines[-1]


def test_nothing_is_shown_of_a_quiet_run(capsys: pytest.CaptureFixture[str]) -> None:
    config = load_config(TOY, ["iterations=1", "episodes_per_iteration=2"])
    with progress_bar(config.training, quiet=True) as show:
        for iteration in iterations(config):
            show(iteration)
    assert capsys.readouterr() == ("", "")
