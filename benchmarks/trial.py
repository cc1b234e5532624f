"""One learner on one task from one seed, and its learning curve against what the task was used for."""

from __future__ import annotations

import csv
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.files import write_whole
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config


@dataclass(frozen=True)
class Trial:
    """What a learner is given.

    Attributes:
        config: task, seed, and the settings of those learners that have them.
        episodes: the learner ends with the first update after so many.
        discounted: whether the task's thresholds are of the discounted return.
    """

    config: Config
    episodes: int
    discounted: bool

    @property
    def judged_by(self) -> float:
        """The discount of the return that the thresholds are of."""
        return self.config.training.discount if self.discounted else 1.0


class Point(NamedTuple):
    """One point of a learning curve, after an update.

    Attributes:
        episodes: real episodes that the learner explored in so far.
        steps: of these.
        cpu_seconds: spent so far on learning and exploring, all threads together, evaluations left out.
        undiscounted_return: mean over the evaluation episodes.
        discounted_return: the same with the task's discount.
    """

    episodes: int
    steps: int
    cpu_seconds: float
    undiscounted_return: float
    discounted_return: float


class Meter:
    """Counts what a learner spends. Owns the counts.

    Args:
        discount: of the returns.
    """

    def __init__(self, discount: float) -> None:
        self.episodes = 0
        self.steps = 0
        self._discount = discount
        self._begin = time.process_time()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Let what is done meanwhile cost no CPU seconds."""
        at = time.process_time()
        yield
        self._begin += time.process_time() - at

    def point(self, rewards: Array) -> Point:
        """Return the point of a policy that earned these rewards, shape (episodes, horizon), without noise."""
        seconds = time.process_time() - self._begin
        undiscounted, discounted = (
            float((rewards @ discount ** np.arange(rewards.shape[1])).mean()) for discount in (1.0, self._discount)
        )
        return Point(self.episodes, self.steps, seconds, undiscounted, discounted)


class MeteredRunner:
    """Lets policies act in the task of a configuration, by a meter: exploring episodes count, noise-free ones do not.

    Args:
        config: of the task.
        meter: counts.
    """

    def __init__(self, config: Config, meter: Meter) -> None:
        self._runner = runner_of(config.environment)
        self._meter = meter
        self.spaces = self._runner.spaces

    def capacity(self, num_envs: int) -> int:
        """Return 1: none run ahead, so that exploring and evaluation episodes are metered apart."""
        return 1

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        if not batch.explore:
            with self._meter.paused():
                return self._runner.collect(policy, batch)
        episodes = self._runner.collect(policy, batch)
        self._meter.episodes += len(episodes)
        self._meter.steps += int(episodes.mask.sum())
        return episodes


def write_curve(path: Path, points: Iterable[Point]) -> None:
    """Write a learning curve, whole or not at all."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([Point._fields, *points])
    write_whole(path, text.getvalue().encode())


def read_curve(path: Path) -> list[Point]:
    """Return the points of a learning curve."""
    with path.open(newline="") as file:
        _, *lines = csv.reader(file)
    return [Point(int(e), int(s), *map(float, rest)) for e, s, *rest in lines]
