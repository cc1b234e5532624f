"""Recorder that assembles the steps of a batch into episodes."""

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.simulation import Frame


class EpisodeRecorder:
    """Assembles the episodes of a batch step by step; entries after the end of an episode are 0.

    Args:
        batch: the batch to record.
        spaces: spaces of its task.
    """

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
