"""The in-process runner."""

from typing import Self

from rkhs_ros.base.endings import RunError
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.execution import Record, discard, record_kinds
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.episode_recorder import EpisodeRecorder
from rkhs_ros.rollouts.simulation import Simulation


class InlineRunner:
    """Runner of policies in a simulation in this process; as a context manager it closes the simulation at the end.

    Args:
        simulation: simulation of the task.

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

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run in one batch."""
        return self.simulation.capacity(num_envs)

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy; run a batch that exceeds the capacity in parts.

        Raises:
            RunError: the environment failed, or a number is not finite.
        """
        parts = batch.parts(self.capacity(batch.num_envs))
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
        record_kinds(self.record, batch, episodes, [])
        return episodes

    def _actions(self, acting: Acting, step: int, observations: Array) -> Array:
        try:
            return acting(step, observations)
        except RunError as error:
            raise RunError(f"{self.simulation.environment}: {error}") from error
