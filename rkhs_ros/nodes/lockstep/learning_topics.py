"""The monitoring topics of a learner: its progress, and markers of what it has learnt."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from builtin_interfaces.msg import Time as Stamp
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.learning.training import Iteration
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.nodes.core.newest_topic import NewestTopic
from rkhs_ros.nodes.lockstep.learning_messages import marker_array, progress_message
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.runs.curve import Curve, Row
from rkhs_ros.sketches.sketch import Sketcher

MARKERS_PERIOD_S = 0.5  # between marker messages, which take some milliseconds to make


class LearningTopics:
    """Publishes the progress and markers of a run.

    Owns the topics, and the sketch of the run.

    Args:
        node: the learner node.
        training: settings of the run.
    """

    def __init__(self, node: Node, training: Training) -> None:
        self._clock = node.get_clock()
        self._training = training
        self._folder = Path()
        self._sketcher: Sketcher | None = None
        self._progress = NewestTopic(node, LearningProgress, "progress", always=True)
        self._markers = NewestTopic(node, MarkerArray, "learning_markers", MARKERS_PERIOD_S)

    def begin(self, folder: Path, spaces: Spaces) -> None:
        """Set the folder of the results and the spaces of the task, and publish the initial progress."""
        self._folder = folder.resolve()
        self._sketcher = Sketcher(spaces, self._training.discount)
        self._progress.offer(partial(self._progressed, Curve(folder / "curve.csv").rows()))

    def publish(self, iteration: Iteration, rows: Sequence[Row]) -> None:
        """Publish an iteration, with the last lines of the learning curve, at the topics' limited rates."""
        self._progress.offer(partial(self._progressed, rows))
        if self._sketcher is not None:
            self._sketcher.add(iteration)
            self._markers.offer(partial(self._marked, self._sketcher, iteration))

    def heartbeat(self) -> float:
        """Publish due messages; return the seconds until the next ones may be due."""
        return min(self._progress.heartbeat(), self._markers.heartbeat())

    def close(self) -> None:
        """Publish pending messages."""
        self._progress.close()
        self._markers.close()

    def _progressed(self, rows: Sequence[Row]) -> LearningProgress:
        return progress_message(self._now(), self._training.name, self._folder, self._training.iterations, rows)

    def _marked(self, sketcher: Sketcher, iteration: Iteration) -> MarkerArray:
        return marker_array(self._now(), sketcher.sketch(iteration))

    def _now(self) -> Stamp:
        return self._clock.now().to_msg()
