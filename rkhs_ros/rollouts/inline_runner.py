"""The in-process runner, and the recorder that assembles the steps of a batch into episodes."""

from typing import Self

import numpy as np

from rkhs_ros.base.endings import RunError
from rkhs_ros.learning.episodes import Episodes, Record, discard
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.simulation import Frame, Simulation


class InlineRunner:
    """Runner of policies in a simulation in this process; as a context manager it closes the simulation at the end.

    Attributes:
        record: callback for each finished batch.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.spaces = simulation.spaces
        self.record: Record = discard

    def __enter__(self) -> Self:
        """Return the runner."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the simulation."""
        self.simulation.close()

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy; run a batch that exceeds the capacity in parts."""
        parts = batch.parts(self.simulation.capacity(batch.num_envs))
        return Episodes.concatenate(self._together(policy, part) for part in parts)

    def _together(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        acting = Acting(policy, batch, explore=batch.explore)
        recorder = EpisodeRecorder(batch, self.spaces)
        frame = self.simulation.start(batch)
        recorder.observed(0, frame)
        step = 0
        while not frame.is_over:
            actions = self._actions(acting, step, frame.observations)
            frame = self.simulation.step(actions)
            recorder.acted(step, actions)
            step += 1
            recorder.observed(step, frame)
        episodes = recorder.episodes()
        self.record(batch, episodes, [])
        return episodes

    def _actions(self, acting: Acting, step: int, observations: Array) -> Array:
        try:
            return acting(step, observations)
        except RunError as error:
            raise RunError(f"{self.simulation.environment}: {error}") from error


class EpisodeRecorder:
    """Assembles the episodes of a batch step by step; entries after the end of an episode are 0."""

    def __init__(self, batch: Batch, spaces: Spaces) -> None:
        shape = (batch.num_envs, batch.horizon)
        self._horizon = batch.horizon
        self._observations = np.zeros((*shape, spaces.observation_dim))
        self._actions = np.zeros((*shape, spaces.action_dim))
        self._rewards = np.zeros(shape)
        self._mask = np.zeros(shape, dtype=bool)

    def observed(self, step: int, frame: Frame) -> None:
        """Record the observations before a step, and the rewards of the previous step."""
        if step < self._horizon:
            np.copyto(self._observations[:, step], frame.observations, where=frame.active[:, None])
            self._mask[:, step] = frame.active
        if step > 0:
            self._rewards[:, step - 1] = frame.rewards
        self._last = frame

    def acted(self, step: int, actions: Array) -> None:
        """Record the actions of a step."""
        np.copyto(self._actions[:, step], actions, where=self._mask[:, step, None])

    def episodes(self) -> Episodes:
        """Return the recorded episodes."""
        return Episodes(
            observations=self._observations,
            actions=self._actions,
            rewards=self._rewards,
            mask=self._mask,
            final_observations=self._last.observations,
            terminated=self._last.terminated,
        )
