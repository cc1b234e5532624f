"""The table of tasks in benchmarks/: its searches, their costs, and the stored and printed curves."""

from pathlib import Path

import pytest

import tasks
from task_learners import LEARNERS, Learner
from trial import Point, Trial


class Counted:
    """A learner with given curves that is interrupted once."""

    def __init__(self, interrupted_at: int) -> None:
        self.seeds: list[int] = []
        self._interrupted_at = interrupted_at

    def __call__(self, trial: Trial) -> list[Point]:
        seed = trial.config.training.seed
        if len(self.seeds) == self._interrupted_at:
            self._interrupted_at = -1
            raise KeyboardInterrupt
        self.seeds.append(seed)
        return [Point(10, 200, 0.1, 15.0 + seed, 14.0 + seed)]


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    learn = Counted(interrupted_at=2)
    monkeypatch.setitem(LEARNERS, "counted", Learner(learn))
    return learn


def table(out: Path, *arguments: str) -> int:
    return tasks.main(["--tasks", "toy", "--seeds", "0-3", "--jobs", "1", "--quiet", "--out", str(out), *arguments])


def test_an_interrupted_table_continues(tmp_path: Path, counted: Counted, capsys: pytest.CaptureFixture[str]) -> None:
    assert table(tmp_path, "--learners", "counted") == 130
    assert "interrupted" in capsys.readouterr().err
    assert counted.seeds == [0, 1]
    assert table(tmp_path, "--learners", "counted") == 0
    assert counted.seeds == [0, 1, 2, 3]
    assert "| counted | 4 |" in (tmp_path / "table.md").read_text()
    table(tmp_path, "--learners", "counted")
    assert counted.seeds == [0, 1, 2, 3]


@pytest.mark.parametrize("name", tasks.TASKS)
def test_every_task_has_settings_that_fit(name: str) -> None:
    for learner in LEARNERS:
        trial = tasks.TASKS[name].trial(learner, 3, None)
        assert trial.config.training.seed == 3
        assert trial.episodes >= 100
    assert tasks.TASKS["toy"].trial("ours", 0, None).config.training.horizon == 20
