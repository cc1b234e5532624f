"""Sketches stay in their box, and show the visited states and the centres of the policy."""

from dataclasses import replace

import numpy as np
import pytest

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training import Iteration, train
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.curve import BEGINNING, Row, seconds_left
from rkhs_ros.sketches.sketch import MOST_ATTEMPTS, MOST_EPISODES, MOST_POINTS, SIZE, Sketch, Sketcher
from test.unit.conftest import model_free

TRAINING = model_free(name="short", iterations=3, episodes_per_iteration=3, evaluation_episodes=1, horizon=150)


def learnt(environment: str) -> tuple[list[Iteration], Spaces]:
    runner = InlineRunner(Simulation(environment))
    return list(train(TRAINING, runner)), runner.spaces


def check(sketch: Sketch) -> None:
    points = np.concatenate([sketch.centres, *(part for path in sketch.paths for part in path)])
    assert (np.abs(points) <= SIZE / 2 + 1e-9).all()


def test_paths_and_centres_of_a_pendulum() -> None:
    iterations, spaces = learnt("rkhs/Pendulum-v0")
    sketcher = Sketcher(spaces, TRAINING.discount)
    for iteration in iterations:
        sketcher.add(iteration)
        sketch = sketcher.sketch(iteration)
        check(sketch)
        assert len(sketch.paths) == iteration.number
        assert len(sketch.centres) == iteration.metrics.centres
        assert sum(len(part) for part in sketch.paths[-1]) == MOST_POINTS
    assert [axis.split(":")[0] for axis in sketch.axes] == ["angle (rad)", "angular velocity (rad/s)", "torque"]
    jumps = np.concatenate([np.abs(np.diff(part, axis=0))[:, :2] for path in sketch.paths for part in path])
    assert (jumps <= 0.6 * SIZE[:2]).all()  # the path is split where the angle wraps


def test_heights_are_the_actions_and_ranges_only_grow() -> None:
    (first, second, _), spaces = learnt("rkhs/Toy-v0")
    sketcher = Sketcher(spaces, TRAINING.discount)
    lows, highs = [], []
    for iteration in (first, second):
        sketcher.add(iteration)
        words = sketcher.sketch(iteration).axes[0].split(": ")[1]
        low, high = (float(word) for word in words.split(" to "))
        lows.append(low)
        highs.append(high)
    assert lows[1] <= lows[0] < highs[0] <= highs[1]
    alone = Sketcher(spaces, TRAINING.discount)
    alone.add(first)
    ((path,),) = alone.sketch(first).paths
    actions = spaces.clip(first.evaluation.actions[0])[:, 0]
    steps = np.linspace(0, len(actions) - 1, len(path)).round().astype(int)
    assert np.corrcoef(path[:, 2], actions[steps])[0, 1] == pytest.approx(1.0)


def test_only_the_last_episodes_are_stored() -> None:
    (iteration, *_), spaces = learnt("rkhs/Toy-v0")
    sketcher = Sketcher(spaces, TRAINING.discount)
    for _ in range(3 * MOST_EPISODES):
        sketcher.add(iteration)
    assert len(sketcher.sketch(iteration).paths) == MOST_EPISODES


def test_a_one_step_task_shows_its_attempts() -> None:
    (iteration, *_), _ = learnt("rkhs/Toy-v0")
    rng = np.random.default_rng(0)
    rows = 2 * MOST_ATTEMPTS
    actions, rewards = rng.uniform(-2.0, 2.0, (rows, 1, 2)), rng.uniform(size=(rows, 1))
    none = Episodes.none(1, 3, 2)
    episodes = Episodes.without_ends(np.zeros((rows, 1, 3)), actions, rewards, np.ones((rows, 1), dtype=bool))
    sketcher = Sketcher(Spaces((3,), -np.ones(2), np.ones(2)), 0.99)
    iteration = replace(iteration, exploration=episodes, evaluation=none)
    sketcher.add(iteration)
    sketch = sketcher.sketch(iteration)
    check(sketch)
    assert [axis.split(":")[0] for axis in sketch.axes] == ["action 0", "action 1", "return"]
    assert sketch.axes[0] == "action 0: -1 to 1"  # within the bounds
    assert len(sketch.paths) == MOST_ATTEMPTS
    assert len(sketch.centres) == 0


def test_the_remaining_time_follows_from_the_last_iterations() -> None:
    def rows(seconds: list[float]) -> list[Row]:
        return [BEGINNING._replace(iteration=i + 1, seconds=s) for i, s in enumerate(seconds)]

    assert np.isnan(seconds_left([], 10))
    assert np.isnan(seconds_left(rows([1.0]), 10))
    assert seconds_left(rows([1.0, 3.0]), 10) == 16.0
    slow_at_first = [100.0 * i for i in range(30)] + [2900.0 + 0.5 * i for i in range(1, 21)]
    assert seconds_left(rows(slow_at_first), 70) == pytest.approx(10.0)
