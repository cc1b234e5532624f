"""The table of tasks in benchmarks/."""

import pytest

import tasks
from task_learners import LEARNERS


@pytest.mark.parametrize("name", tasks.TASKS)
def test_every_task_has_settings_that_fit(name: str) -> None:
    for learner in LEARNERS:
        trial = tasks.TASKS[name].trial(learner, 3, None)
        assert trial.config.training.seed == 3
        assert trial.episodes >= 100
    assert tasks.TASKS["toy"].trial("ours", 0, None).config.training.horizon == 20
