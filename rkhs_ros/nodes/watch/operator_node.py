"""The operator node of ``rkhs robot``: forwards an operator's command to the gate or the robot node."""

from __future__ import annotations

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rkhs_ros.base.endings import Stop
from rkhs_ros.base.validation import pick
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError, run
from rkhs_ros.nodes.watch.operator_calls import SERVICES, OperatorCalls


class OperatorNode(Node):
    """Calls the service of one command."""

    def __init__(self) -> None:
        """Read the command from the parameter ``word``."""
        super().__init__("operator")
        self.command = str(self.declare_parameter("word", "").value)
        self.service, *_ = pick(self.command, SERVICES, "word")
        self.calls = OperatorCalls(self, [self.command])


def forward(node: OperatorNode, stop: Stop) -> None:
    """Call the service, and print its answer.

    Raises:
        PeerError: the service is not available, does not answer, or refuses.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    call = node.calls.call(node.command)
    while not call.is_over:
        if stop.is_set():
            return
        node.calls.proceed()
        executor.spin_once(timeout_sec=SIGNAL_CHECK_S)
    if call.failure:
        hint = "" if call.is_found else "; pass the run's folder, or set ROS_DOMAIN_ID"
        raise PeerError(f"{node.service}: {call.failure}{hint}")
    if not call.answer.success:
        raise PeerError(f"{node.command} was refused: {call.answer.message}")
    print(call.text)


def main() -> None:
    """Run the operator node."""
    run(OperatorNode, "operator", forward)


if __name__ == "__main__":
    main()
