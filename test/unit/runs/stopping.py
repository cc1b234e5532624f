"""A runner that is interrupted after a number of batches."""

from typing import Any, ClassVar

from rkhs_ros.learning.episodes import Record
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Environment


class Stopping:
    """Run a number of batches, two per iteration if none run ahead, and then raise an error.

    The batches of the final evaluation, which have another seed, do not count.
    """

    environment: ClassVar = Environment("rkhs/Toy-v0", {})

    def __init__(self, batches: float = float("inf"), error: BaseException | None = None) -> None:
        self._runner = InlineRunner(Simulation(self.environment.id, self.environment.options))
        self.spaces = self._runner.spaces
        self._batches = batches
        self._error = error or KeyboardInterrupt()
        self._seed: int | None = None

    @property
    def record(self) -> Record:
        return self._runner.record

    @record.setter
    def record(self, record: Record) -> None:
        self._runner.record = record

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Any:
        self._seed = batch.seed if self._seed is None else self._seed
        self._batches -= batch.seed == self._seed
        if self._batches < 0:
            raise self._error
        return self._runner.collect(policy, batch)
