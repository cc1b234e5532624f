"""The operator node of ``rkhs robot``: forwards an operator's command to the gate or the robot node."""

import time
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from rkhs_ros.base.endings import Stop
from rkhs_ros.base.validation import pick
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError, run

FOUND_TIMEOUT_S, ANSWER_TIMEOUT_S = 5.0, 10.0  # until the service is found, and from then until it answers
SERVICES: dict[str, tuple[str, Any, Any]] = {  # by command: the service, its type, and the request
    "arm": ("gate/arm", Trigger, Trigger.Request()),
    "stop": ("gate/stop", Trigger, Trigger.Request()),
    "start": ("robot/start", Trigger, Trigger.Request()),
    "pause": ("robot/pause", SetBool, SetBool.Request(data=True)),
    "veto": ("robot/veto", Trigger, Trigger.Request()),
}


class OperatorNode(Node):
    """Calls the service of one command."""

    def __init__(self) -> None:
        """Read the command from the parameter ``word``."""
        super().__init__("operator")
        self.command = str(self.declare_parameter("word", "").value)
        self.service, kind, self.request = pick(self.command, SERVICES, "word")
        self.client = self.create_client(kind, self.service)


def forward(node: OperatorNode, stop: Stop) -> None:
    """Call the service once, and print its answer.

    Raises:
        PeerError: the service is not available, does not answer, or refuses.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    call, deadline = None, time.monotonic() + FOUND_TIMEOUT_S
    while call is None or not call.done():
        if stop.is_set():
            return
        if call is None and node.client.service_is_ready():
            call, deadline = node.client.call_async(node.request), time.monotonic() + ANSWER_TIMEOUT_S
        if time.monotonic() > deadline:
            raise PeerError(f"{node.service}: {_silence(found=call is not None)}")
        executor.spin_once(timeout_sec=SIGNAL_CHECK_S)
    answer = call.result()
    if not answer.success:
        raise PeerError(f"{node.command} was refused: {answer.message}")
    print(f"{node.command}: done" + f" ({answer.message})" * bool(answer.message))


def _silence(*, found: bool) -> str:
    if found:
        return "the node does not answer; it may have acted, see rkhs status"
    return "the node is not running; pass the run's folder, or set ROS_DOMAIN_ID"


def main() -> None:
    """Run the operator node."""
    run(OperatorNode, "operator", forward)


if __name__ == "__main__":
    main()
