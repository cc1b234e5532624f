"""A relay that simulates a bad network: it loses, duplicates and delays observations and actions."""

import argparse
import heapq
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rkhs_interfaces.msg import Action, Observation
from rkhs_ros.base.endings import Stop
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS

LONGEST = 0.05  # seconds, the greatest delay of a message
TOPICS = {"observation": Observation, "action": Action}


class Relay(Node):
    """Between topics ``NAME_sent`` and ``NAME``."""

    def __init__(self, share: float, seed: int) -> None:
        super().__init__("relay")
        self.counts = dict.fromkeys(("passed", "dropped", "doubled", "delayed"), 0)
        self._share = share
        self._draws = np.random.default_rng(seed)
        self._held: list[tuple[float, int, Callable[[], None]]] = []
        for name, kind in TOPICS.items():
            out = self.create_publisher(kind, name, LOCKSTEP_QOS)
            self.create_subscription(kind, f"{name}_sent", lambda m, out=out: self._pass(m, out), LOCKSTEP_QOS)

    def release(self) -> float:
        """Send the delayed messages that are due; return the seconds until the next one."""
        while self._held and self._held[0][0] <= time.monotonic():
            heapq.heappop(self._held)[2]()
        return min(max(self._held[0][0] - time.monotonic(), 0.0), LONGEST) if self._held else LONGEST

    def _pass(self, message: Any, out: Any) -> None:
        draw = self._draws.random() / self._share if self._share else 3.0
        fate = ("dropped", "doubled", "delayed", "passed")[min(int(draw), 3)]
        self.counts[fate] += 1
        if fate == "delayed":
            due = time.monotonic() + self._draws.uniform(0.0, LONGEST)
            heapq.heappush(self._held, (due, sum(self.counts.values()), lambda: out.publish(message)))
        for _ in range({"dropped": 0, "doubled": 2, "delayed": 0, "passed": 1}[fate]):
            out.publish(message)


def main() -> None:
    """Relay until the stop, and print the counts of messages."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--share", type=float, required=True, help="of messages dropped, as of those doubled, delayed")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Relay(options.share, options.seed)
    executor = EventsExecutor()
    executor.add_node(node)
    stop = Stop()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    while not stop.is_set():
        executor.spin_once(timeout_sec=node.release())
    print(", ".join(f"{count} {fate}" for fate, count in node.counts.items()))
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
