"""Run one learner on one task with one seed, and store its learning curve against the episodes used."""

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
    """The input of a learner.

    Attributes:
        config: task, seed, and the settings of learners that use them.
        episodes: budget; the learner stops after the first update that reaches it.
        discounted: whether the thresholds of the task are for the discounted return.
    """

    config: Config
    episodes: int
    discounted: bool

    @property
    def judged_by(self) -> float:
        """Discount of the return that the thresholds are for."""
        return self.config.training.discount if self.discounted else 1.0


class Point(NamedTuple):
    """One point of a learning curve, after an update.

    Attributes:
        episodes: real exploration episodes so far.
        steps: steps of these episodes.
        cpu_seconds: CPU time of training and exploration so far, over all threads, without evaluations.
        undiscounted_return: mean over the evaluation episodes.
        discounted_return: the same with the task's discount.
    """

    episodes: int
    steps: int
    cpu_seconds: float
    undiscounted_return: float
    discounted_return: float


class Meter:
    """Counts episodes, steps and CPU time of a learner. Owns the counts.

    Args:
        discount: discount of the returns.
    """

    def __init__(self, discount: float) -> None:
        self.episodes = 0
        self.steps = 0
        self._discount = discount
        self._begin = time.process_time()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Exclude the CPU time of the block."""
        at = time.process_time()
        yield
        self._begin += time.process_time() - at

    def point(self, rewards: Array) -> Point:
        """Return the point of the curve for evaluation rewards of shape (episodes, horizon)."""
        seconds = time.process_time() - self._begin
        undiscounted, discounted = (
            float((rewards @ discount ** np.arange(rewards.shape[1])).mean()) for discount in (1.0, self._discount)
        )
        return Point(self.episodes, self.steps, seconds, undiscounted, discounted)


class MeteredRunner:
    """Rolls out policies in the task of a configuration, and counts exploration episodes but not evaluation episodes.

    Args:
        config: configuration of the task.
        meter: counts the episodes.
    """

    def __init__(self, config: Config, meter: Meter) -> None:
        self._runner = runner_of(config.environment)
        self._meter = meter
        self.spaces = self._runner.spaces

    def capacity(self, num_envs: int) -> int:
        """Return 1: no episodes run in advance, so that exploration and evaluation are counted separately."""
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
    """Write a learning curve atomically."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([Point._fields, *points])
    write_whole(path, text.getvalue().encode())


def read_curve(path: Path) -> list[Point]:
    """Return the points of a learning curve."""
    with path.open(newline="") as file:
        _, *lines = csv.reader(file)
    return [Point(int(e), int(s), *map(float, rest)) for e, s, *rest in lines]
