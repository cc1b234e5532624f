"""Recorded runs to test with, short ones of the toy, and what is the same in two recordings."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.execution import Execution, Record, forget
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.recording import RecordedBatch, Recording
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.run import run_training
from rkhs_ros.runs.simulation import Simulation

TRAINING = Training(name="short", iterations=4, episodes_per_iteration=3, evaluation_episodes=2, horizon=5)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TRAINING)
ARRAYS = [f.name for f in fields(Episodes)]


def longer(iterations: int, **changes: Any) -> Config:
    return replace(CONFIG, training=replace(TRAINING, iterations=iterations, **changes))


class Robot:
    """Runs one episode at a time, tells how it went, has every third one void at first, and counts; may be stopped."""

    def __init__(self, episodes: float = float("inf"), void_every: int = 3) -> None:
        self._runner = InlineRunner(Simulation("rkhs/Toy-v0", None, 1))
        self.spaces = self._runner.spaces
        self.record: Record = forget
        self.moved: list[tuple[bool, int]] = []
        self._left = episodes
        self._void_every = void_every

    def room(self, rows: int) -> int:
        return 1

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        found = Episodes.none(batch.horizon, self.spaces.observation_dim, self.spaces.action_dim)
        for part in batch.parts(1):
            if self._left <= 0:
                raise KeyboardInterrupt
            self._left -= 1
            episodes = self._runner.collect(policy, part)
            if part.first_episode % self._void_every == 1:
                self.record(part, replace(episodes, rewards=episodes.rewards - 7.0), [execution(part, "stopped")])
            self.moved.append((part.explore, part.first_episode))
            self.record(part, episodes, [execution(part)])
            found = found + episodes
        return found


def execution(batch: Batch, reason: str = "") -> Execution:
    stamps = 10**18 + 10**9 * batch.first_episode + np.arange(batch.horizon + 1) * 50_000_000
    return Execution(
        stamps=stamps,
        executed=np.full((batch.horizon, 2), 0.5),
        flags=np.arange(batch.horizon, dtype=np.uint32),
        void_reason=reason,
    )


def recorded_run(folder: Path, config: Config = CONFIG, runner: Any = None, **more: Any) -> Path:
    """Record a run, or go on with it, and return its file."""
    runner = runner or InlineRunner(Simulation(config.environment.id, config.environment.options))
    return run_training(config, runner, folder, quiet=True, record=True, **more) / "recording.mcap"


def same_batch(one: RecordedBatch, other: RecordedBatch) -> bool:
    return one.batch == other.batch and all(
        np.array_equal(getattr(one.episodes, name), getattr(other.episodes, name)) for name in ARRAYS
    )


def content(recording: Recording) -> list[Any]:
    """Return all but times and the head, for comparison."""
    batches = [
        (b.batch, b.version, *(getattr(b.episodes, name).tobytes() for name in ARRAYS)) for b in recording.batches
    ]
    return [batches, sorted(recording.policies), [repr(update) for update in recording.updates]]
