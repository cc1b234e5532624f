"""A gate with injected failures of a callback, a check or the executor, triggered by a topic."""

from dataclasses import replace

import numpy as np
from rclpy.executors import Executor
from std_msgs.msg import String

from rkhs_ros.nodes.core.spin import PeerError, run, serve
from rkhs_ros.nodes.robot.gate_node import GateNode
from rkhs_ros.robot.limits import Setpoint


class FailingGate(GateNode):
    """Fails as it is told."""

    def open(self) -> None:
        """Hear how to fail, too."""
        super().open()
        self._fault = ""
        self.create_subscription(String, "fail", self._fail, 1)

    def heartbeat(self) -> float:
        """Send what is due, and fail again and again where the fault stays."""
        wait = super().heartbeat()
        if self._fault == "check":
            raise PeerError("expected one gate node, got an older one that is already running")
        if self._fault == "exits":
            raise SystemExit(3)
        return wait

    def _fail(self, message: String) -> None:
        self._fault = message.data
        if self._fault == "callback":
            raise TypeError("a callback failed")
        if self._fault == "tick":
            self._state = replace(self._state, motion=Setpoint(np.array([]), np.array([])))
        if self._fault == "exit":
            raise SystemExit(3)
        if self._fault == "executor":
            assert isinstance(self.executor, Executor)
            self.executor.shutdown()


if __name__ == "__main__":
    run(FailingGate, "gate", serve)
