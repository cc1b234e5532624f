"""The operator node of ``rkhs robot``: passes on to gate and robot node what a person decides."""

from __future__ import annotations

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rkhs_ros.base.endings import Stop
from rkhs_ros.base.validation import pick
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError, run
from rkhs_ros.nodes.watch.operator_calls import SERVICES, OperatorCalls


class OperatorNode(Node):
    """Calls the service of one word."""

    def __init__(self) -> None:
        """Read which word is to be passed on."""
        super().__init__("operator")
        self.word = str(self.declare_parameter("word", "").value)
        self.service, *_ = pick(self.word, SERVICES, "word")
        self.calls = OperatorCalls(self, [self.word])


def pass_on(node: OperatorNode, stop: Stop) -> None:
    """Call the service, and print what it answers.

    Raises:
        PeerError: nobody offers it, it does not answer, or it refuses.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    call = node.calls.call(node.word)
    while not call.is_over:
        if stop.is_set():
            return
        node.calls.proceed()
        executor.spin_once(timeout_sec=SIGNAL_CHECK_S)
    if call.failure:
        hint = "" if call.is_found else "; name the run's folder, or set ROS_DOMAIN_ID"
        raise PeerError(f"{node.service}: {call.failure}{hint}")
    if not call.answer.success:
        raise PeerError(f"{node.word} was refused: {call.answer.message}")
    print(call.text)


def main() -> None:
    """Run the operator node."""
    run(OperatorNode, "operator", pass_on)


if __name__ == "__main__":
    main()
