"""The topic ``progress`` of a learner, from which viewers draw the learning curve."""

import time
from array import array
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.learning.iteration import Row
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.runs.curve import BEGINNING, Curve, seconds_left

MOST_RECENT = 256  # iterations in a message
PERIOD_S = 0.2  # between messages
LAST_MESSAGE_TIMEOUT_S = 0.5  # for subscribers to receive the last message before the node exits


class ProgressTopic:
    """Publishes the progress of a run at a limited rate; late subscribers receive the newest message.

    Owns the learning curve until it is published.

    Args:
        node: the learner node.
        training: settings of the run.
    """

    def __init__(self, node: Node, training: Training) -> None:
        self._clock = node.get_clock()
        self._training = training
        self._folder = Path()
        self._publisher = node.create_publisher(LearningProgress, "progress", LATCHED_QOS)
        self._rows: Sequence[Row] | None = None
        self._due = 0.0  # monotonic time, seconds

    def begin(self, folder: Path) -> None:
        """Set the folder of the results, and publish the progress so far."""
        self._folder = folder.resolve()
        self._rows = []
        with suppress(ValueError):  # from a damaged curve, which the run writes again
            self._rows = Curve(folder / "curve.csv").rows()

    def offer(self, rows: Sequence[Row]) -> None:
        """Set the learning curve so far; it replaces an unpublished one."""
        self._rows = rows

    def heartbeat(self) -> float:
        """Publish a due message; return the seconds until the next one may be due."""
        now = time.monotonic()
        if self._rows is None:
            return PERIOD_S
        if now >= self._due:
            self._due = now + PERIOD_S
            self._publish()
        return self._due - now

    def close(self) -> None:
        """Publish the pending message, and wait until subscribers have received it."""
        self._publish()
        self._publisher.wait_for_all_acked(Duration(seconds=LAST_MESSAGE_TIMEOUT_S))

    def _publish(self) -> None:
        if self._rows is None:
            return
        rows, self._rows = self._rows, None
        iterations, recent = self._training.iterations, rows[-MOST_RECENT:]
        message = LearningProgress(
            stamp=self._clock.now().to_msg(),
            run=self._training.name,
            folder=str(self._folder),
            iterations=iterations,
            **(rows[-1] if rows else BEGINNING)._asdict(),
            seconds_left=seconds_left(rows, iterations),
            last_iterations=array("I", [row.iteration for row in recent]),
            last_exploration_returns=array("d", [row.exploration_return for row in recent]),
            last_evaluation_returns=array("d", [row.evaluation_return for row in recent]),
            last_model_returns=array("d", [row.model_return for row in recent]),
        )
        self._publisher.publish(message)
