"""The in-process runner, and how the steps of a batch become episodes."""

from __future__ import annotations

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.simulation import Frame, Simulation


class EpisodeRecorder:
    """The episodes of a batch as they grow, step by step.

    Args:
        batch: the batch that is recorded.
        observation_dim: d.
        action_dim: n.
    """

    def __init__(self, batch: Batch, observation_dim: int, action_dim: int) -> None:
        shape = (batch.rows, batch.horizon)
        self._horizon = batch.horizon
        self._observations = np.zeros((*shape, observation_dim))
        self._actions = np.zeros((*shape, action_dim))
        self._rewards = np.zeros(shape)
        self._mask = np.zeros(shape, dtype=bool)

    def observed(self, step: int, frame: Frame) -> None:
        """Record what was seen before a step, and the rewards of the step before it."""
        if step < self._horizon:
            self._observations[:, step] = frame.observations
            self._mask[:, step] = frame.active
        if step > 0:
            self._rewards[:, step - 1] = frame.rewards

    def acted(self, step: int, actions: Array) -> None:
        """Record the actions of a step."""
        self._actions[:, step] = actions

    def episodes(self) -> Episodes:
        """Return the recorded episodes."""
        return Episodes(self._observations, self._actions, self._rewards, self._mask)


class InlineRunner:
    """Lets policies act in a simulation of this process.

    Args:
        simulation: the task.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.observation_dim = simulation.observation_dim
        self.action_dim = simulation.action_dim

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        acting = Acting(policy, batch, explore=batch.explore)
        recorder = EpisodeRecorder(batch, self.observation_dim, self.action_dim)
        frame = self.simulation.start(batch)
        recorder.observed(0, frame)
        for step in range(batch.horizon):
            actions = acting(step, frame.observations)
            frame = self.simulation.step(actions)
            recorder.acted(step, actions)
            recorder.observed(step + 1, frame)
        return recorder.episodes()
