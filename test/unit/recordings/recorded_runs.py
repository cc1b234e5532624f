"""Short recorded runs of the toy task, and the comparison of recordings."""

from collections import deque
from collections.abc import Collection
from dataclasses import fields, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from rkhs_ros.learning.episodes import Episodes, Execution, Record, discard
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.recording import RecordedBatch, Recording
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.run import run_training
from test.unit.conftest import model_free

TRAINING = model_free(name="short", iterations=4, episodes_per_iteration=3, evaluation_episodes=2, horizon=5)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TRAINING)
ARRAYS = [f.name for f in fields(Episodes)]
SECONDS = count(10**18, 10**9)  # start times of the attempts at episodes, in nanoseconds


def longer(iterations: int, **changes: Any) -> Config:
    return replace(CONFIG, training=replace(TRAINING, iterations=iterations, **changes))


class Robot:
    """Runs and counts single episodes like a robot, discards the first attempt at some, and stops after a number.

    Vetoed episodes, as (explore, number), are repeated after the others of their batch. The period is in nanoseconds.
    """

    def __init__(
        self,
        episodes: float = float("inf"),
        discard_every: int = 3,
        vetoed: Collection[tuple[bool, int]] = (),
        period: int = 50_000_000,
    ) -> None:
        self.runner = InlineRunner(Simulation("rkhs/Toy-v0", None, 1))
        self.spaces = self.runner.spaces
        self.record: Record = discard
        self.moved: list[tuple[bool, int]] = []
        self._left = episodes
        self._discard_every = discard_every
        self._to_veto = set(vetoed)
        self._period = period

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        parts, done = deque(batch.parts(1)), {}
        while parts:
            part = parts.popleft()
            if self._left <= 0:
                raise KeyboardInterrupt
            self._left -= 1
            episodes = self.runner.collect(policy, part)
            spoilt = replace(episodes, rewards=episodes.rewards - 7.0)
            if part.first_episode % self._discard_every == 1:
                self.record(part, spoilt, [execution(part, self._period, "stopped")])
            number = part.explore, part.first_episode
            self.moved.append(number)
            if number in self._to_veto:
                self._to_veto.remove(number)
                finished = execution(part, self._period)
                self.record(part, spoilt, [finished])
                self.record(part, spoilt, [replace(finished, discard_reason="vetoed by the operator")])
                parts.append(part)
            else:
                self.record(part, episodes, [execution(part, self._period)])
                done[part] = episodes
        return Episodes.concatenate(done[part] for part in batch.parts(1))


def execution(batch: Batch, period: int, reason: str = "") -> Execution:
    stamps = next(SECONDS) + np.arange(batch.horizon + 1) * period
    return Execution(
        stamps=stamps,
        executed=np.full((batch.horizon, 2), 0.5),
        flags=np.arange(batch.horizon, dtype=np.uint32),
        discard_reason=reason,
    )


def recorded_run(folder: Path, config: Config = CONFIG, runner: Any = None, **more: Any) -> Path:
    """Record a run, or resume it, and return the recording."""
    is_robot = isinstance(runner, Robot)
    if is_robot:
        config = replace(
            config, environment=replace(config.environment, nodes={"robot": {"task": "rkhs/Toy-v0"}, "gate": {}})
        )
    runner = runner or InlineRunner(Simulation(config.environment.id, config.environment.options))
    return run_training(config, runner, folder, quiet=True, is_robot=is_robot, **more) / "recording.mcap"


def same_batch(one: RecordedBatch, other: RecordedBatch) -> bool:
    return one.batch == other.batch and all(
        np.array_equal(getattr(one.episodes, name), getattr(other.episodes, name)) for name in ARRAYS
    )


def content(recording: Recording) -> list[Any]:
    """Return the content without times and header, for comparison."""
    batches = [
        (b.batch, b.version, *(getattr(b.episodes, name).tobytes() for name in ARRAYS)) for b in recording.batches
    ]
    return [batches, sorted(recording.policies), [repr(update) for update in recording.updates]]
