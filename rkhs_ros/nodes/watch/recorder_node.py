"""The recorder node: records all topics in an MCAP file."""

from __future__ import annotations

import sys
import time
from functools import partial
from importlib import import_module
from itertools import chain, count
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rkhs_ros.base.endings import Stop
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.arguments import require_section
from rkhs_ros.nodes.core.diagnostics import Diagnostics
from rkhs_ros.nodes.core.parameters import declared, given, require_known
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, ReportingNode, run
from rkhs_ros.recordings.container import MessageFile, Stored
from rkhs_ros.recordings.definitions import store_of_all

NAME = "raw"  # of the file, with a number if the name is taken
SEARCH_PERIOD_S = 0.1  # between searches for new topics
CHUNK_BYTES = 256 * 1024  # which a killed recorder may lose; there may be thousands of messages per second
LAST_MESSAGES_S, IDLE_S = 1.0, 0.1  # for queued messages before the exit, and without any message
DEPTH = 1000  # queued messages per topic


class RecorderNode(ReportingNode):
    """Subscribes to all topics.

    Owns the file, the known topics, and the time of the next search for topics.

    Attributes:
        messages: number of written messages.
    """

    def __init__(self) -> None:
        super().__init__("recorder")

    def open(self) -> None:
        """Declare the parameters and open the file.

        Raises:
            ValueError: an unknown parameter, or no output folder.
            OSError: the file cannot be written.
        """
        require_section(self.get_fully_qualified_name(), sys.argv)
        tree = given(self)
        folder = declared(self, tree, "output", "", "folder for the file")
        require_known(tree)
        require(bool(folder), "output", "a folder for the file", "none")
        self.diagnostics = Diagnostics(self, lambda: {"messages": self.messages})
        self._topics: set[str] = set()
        self.messages = 0
        self._search_at = 0.0  # monotonic time, seconds
        names = chain([f"{NAME}.mcap"], (f"{NAME}_{number}.mcap" for number in count(2)))
        free = next(path for path in (Path(folder, name) for name in names) if not path.exists())
        self.file = MessageFile(free, chunk_bytes=CHUNK_BYTES)

    def heartbeat(self) -> float:
        """Search for new topics, and report; return the seconds until more is due."""
        now = time.monotonic()
        if now >= self._search_at:
            self._search_at = now + SEARCH_PERIOD_S
            for topic, kinds in self.get_topic_names_and_types():
                offers = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
                if topic not in self._topics and offers:
                    self._topics.add(topic)
                    self._hear(topic, kinds[0], _fitting(offers))
        return min(self.diagnostics.heartbeat(), self._search_at - now)

    def _hear(self, topic: str, kind: str, qos: QoSProfile) -> None:
        """Subscribe to a topic, if its message definition is known."""
        types = store_of_all()
        if kind not in types.types:
            self.get_logger().warning(f"{topic} is not recorded: the definition of {kind} is not known")
            return
        package, _, name = kind.split("/")
        message = getattr(import_module(f"{package}.msg"), name)
        definition = types.generate_msgdef(kind, ros_version=2)[0]
        self.create_subscription(message, topic, partial(self._write, topic, kind, definition), qos, raw=True)

    def _write(self, topic: str, kind: str, definition: str, content: bytes, info: dict[str, Any]) -> None:
        self.messages += 1
        self.file.write(Stored(topic, kind, definition, content, time.time_ns(), info["source_timestamp"]))


def _fitting(offers: list[QoSProfile]) -> QoSProfile:
    """Return a quality of service that is compatible with all publishers of a topic."""
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _take_what_came(node: RecorderNode, executor: SingleThreadedExecutor) -> None:
    """Write the queued messages, as far as time permits before the node is killed."""
    deadline, before = time.monotonic() + LAST_MESSAGES_S, -1
    while node.messages > before and time.monotonic() < deadline:
        before = node.messages
        executor.spin_once(timeout_sec=IDLE_S)


def record(node: RecorderNode, stop: Stop) -> None:
    """Record until `stop` is set."""
    executor = SingleThreadedExecutor()  # the EventsExecutor does not support serialised messages
    executor.add_node(node)
    try:
        with node.diagnostics.errors_reported():
            while not stop.is_set():
                executor.spin_once(timeout_sec=min(node.heartbeat(), SIGNAL_CHECK_S))
        _take_what_came(node, executor)
    finally:
        node.file.close()


def main() -> None:
    """Run the recorder node."""
    run(RecorderNode, "recorder", record)


if __name__ == "__main__":
    main()
