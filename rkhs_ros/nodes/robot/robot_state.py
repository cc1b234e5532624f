"""A robot's description and motions, published for viewers; imported only if needed, because it takes 0.1 s."""

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.policies.messages import doubles
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.rollouts.visualization import JointStates

MOTION_QOS = QoSProfile(depth=256)  # a whole motion


class RobotState:
    """Publishes a robot's URDF once, and each motion as a whole, with stamps from now on.

    Owns the end time of the last motion. Earlier motions are skipped, because a simulator is faster than a viewer.

    Raises:
        ValueError: the task has no robot.
    """

    def __init__(self, node: Node, simulation: Simulation) -> None:
        description = simulation.robot_description()
        require(description is not None, "robot_state", "a task with joints", simulation.environment)
        self._clock = node.get_clock()
        self._simulation = simulation
        self._motion_end_ns = 0
        self._joint_states = node.create_publisher(JointState, "joint_states", MOTION_QOS)
        self._description = node.create_publisher(String, "robot_description", LATCHED_QOS)
        self._description.publish(String(data=description))

    def publish(self) -> None:
        """Publish the robot's motion of the last step, if there is one and no earlier motion is still running."""
        now_ns = self._clock.now().nanoseconds
        states = self._simulation.joint_states() if now_ns >= self._motion_end_ns else None
        if states is None:
            return
        for message in _messages(states, now_ns):
            self._joint_states.publish(message)
        self._motion_end_ns = now_ns + round(1e9 * states.period * len(states.positions))


def _messages(states: JointStates, begin: int) -> list[JointState]:
    """Return a motion as messages with stamps from ``begin`` on, in nanoseconds."""
    stamps = (begin + round(1e9 * states.period * knot) for knot in range(len(states.positions)))
    return [
        JointState(
            header=Header(stamp=Time(nanoseconds=stamp).to_msg()), name=states.names, position=doubles(positions)
        )
        for stamp, positions in zip(stamps, states.positions, strict=True)
    ]
