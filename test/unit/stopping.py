"""A runner that is interrupted after a number of batches."""

from typing import Any, ClassVar

from rkhs_ros.runs.config import Environment
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.simulation import Simulation


class Stopping:
    """Run a number of batches, two for each iteration if none run ahead, and then raise an error."""

    environment: ClassVar = Environment("rkhs/Toy-v0", {})

    def __init__(
        self, batches: float = float("inf"), error: BaseException | None = None, rows_at_once: int = 1
    ) -> None:
        self._runner = InlineRunner(Simulation(self.environment.id, self.environment.options))
        self.spaces = self._runner.spaces
        self._batches = batches
        self._error = error or KeyboardInterrupt()
        self._rows_at_once = rows_at_once

    def room(self, rows: int) -> int:
        return min(rows, self._rows_at_once)

    def collect(self, *arguments: Any) -> Any:
        self._batches -= 1
        if self._batches < 0:
            raise self._error
        return self._runner.collect(*arguments)
