"""The operator node of ``rkhs robot``: passes on to gate and robot node what a person decides."""

from __future__ import annotations

import time
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from rkhs_ros.base.endings import Stop
from rkhs_ros.base.validation import pick
from rkhs_ros.nodes.spin import SIGNAL_CHECK_S, PeerError, run

FOUND_TIMEOUT_S, ANSWER_TIMEOUT_S = 3.0, 10.0  # until the node is found, and until it answers
SERVICES: dict[str, tuple[str, Any, Any]] = {  # of each word: the service, its type, what is asked
    "arm": ("gate/arm", Trigger, Trigger.Request()),
    "stop": ("gate/stop", Trigger, Trigger.Request()),
    "start": ("robot/start", Trigger, Trigger.Request()),
    "pause": ("robot/pause", SetBool, SetBool.Request(data=True)),
    "veto": ("robot/veto", Trigger, Trigger.Request()),
}


class OperatorNode(Node):
    """Calls one service, once: a word said twice may mean two things."""

    def __init__(self) -> None:
        """Read which word is to be passed on."""
        super().__init__("operator")
        self.word = str(self.declare_parameter("word", "").value)
        self.service, kind, self.request = pick(self.word, SERVICES, "word")
        self.client = self.create_client(kind, self.service)


def pass_on(node: OperatorNode, stop: Stop) -> None:
    """Call the service, and print what it answers.

    Raises:
        PeerError: nobody offers it, it does not answer, or it refuses.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    deadline, future = time.monotonic() + FOUND_TIMEOUT_S, None
    while not (future and future.done()) and not stop.is_set():
        if time.monotonic() > deadline:
            what = "does not answer" if future else "is not there; name the run's folder, or set ROS_DOMAIN_ID"
            raise PeerError(f"{node.service}: the node {what}")
        executor.spin_once(timeout_sec=SIGNAL_CHECK_S)
        if future is None and node.client.service_is_ready():
            deadline, future = time.monotonic() + ANSWER_TIMEOUT_S, node.client.call_async(node.request)
    if future and future.done():
        answer = future.result()
        if not answer.success:
            raise PeerError(f"{node.word} was refused: {answer.message}")
        print(f"{node.word}: done" + f" ({answer.message})" * bool(answer.message))


def main() -> None:
    """Run the operator node."""
    run(OperatorNode, "operator", pass_on)


if __name__ == "__main__":
    main()
