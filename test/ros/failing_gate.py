"""A gate with injected failures of a callback, a check or the executor, triggered by a topic."""

from dataclasses import replace

import numpy as np
from rclpy.executors import Executor
from std_msgs.msg import String

from rkhs_ros.nodes.core.spin import PeerError, run, serve
from rkhs_ros.nodes.robot.gate_node import GateNode
from rkhs_ros.robot.limits import Setpoint


class FailingGate(GateNode):
    """Fails as the topic says."""

    def open(self) -> None:
        super().open()
        self._fault = ""
        self.create_subscription(String, "fail", self._fail, 1)

    def heartbeat(self) -> float:
        """Send what is due, and fail again and again if the check fails."""
        wait = super().heartbeat()
        if self._fault == "check":
            raise PeerError("expected one gate node, got an older one that is already running")
        return wait

    def _fail(self, message: String) -> None:
        self._fault = message.data
        if self._fault == "callback":
            raise TypeError("a callback failed")
        if self._fault == "tick":
            self._state = replace(self._state, motion=Setpoint(np.array([]), np.array([])))
        if self._fault == "executor":
            assert isinstance(self.executor, Executor)
            self.executor.shutdown()


if __name__ == "__main__":
    run(FailingGate, "gate", serve)
