"""The body of the arm in PyBullet: the Panda that PyBullet includes, with its meshes."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from sim_nodes.bullet import connected, pybullet, silence

with silence(1):
    import pybullet_data

FILE = Path(pybullet_data.getDataPath(), "franka_panda", "panda.urdf")
JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))
BASE, TOOL = "panda_link0", "panda_grasptarget"
STIFFNESS = 50.0  # 1/s: commanded speed of a motor per position error
GRAVITY = -9.81  # m/s²


class Pose(NamedTuple):
    """Pose of a link in the base's frame: x, y, z in metres, and a quaternion x, y, z, w."""

    position: tuple[float, ...]
    orientation: tuple[float, ...]


class ArmBody:
    """A Panda whose motors follow a motion within their torque limits.

    Owns a PyBullet client.
    """

    def __init__(self, rate: float, position: Array) -> None:
        self._client = connected(rate)
        self._client.setGravity(0.0, 0.0, GRAVITY)
        self._body = self._client.loadURDF(str(FILE), useFixedBase=True)
        links = {self._info(index)[12].decode(): index for index in range(self._client.getNumJoints(self._body))}
        names = {self._info(index)[1].decode(): index for index in links.values()}
        self._joints, self._tool = [names[joint] for joint in JOINTS], links[TOOL]
        infos = [self._info(index) for index in self._joints]
        self.lower, self.upper, self._efforts, self.velocity = (
            np.array([info[field] for info in infos]) for field in (8, 9, 10, 11)
        )
        for index, angle in zip(self._joints, position, strict=True):
            self._client.resetJointState(self._body, index, angle)

    def step(self, position: Array, velocity: Array) -> None:
        """Simulate one step; the motors track the given positions and velocities."""
        sensed = np.array([state[0] for state in self._client.getJointStates(self._body, self._joints)])
        self._client.setJointMotorControlArray(
            self._body,
            self._joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=(velocity + STIFFNESS * (position - sensed)).tolist(),
            forces=self._efforts.tolist(),
        )
        self._client.stepSimulation()

    def joints(self) -> tuple[Array, Array, Array]:
        """Return positions, velocities and torques of the joints, each of shape (7,)."""
        states = self._client.getJointStates(self._body, self._joints)
        position, velocity, torque = (np.array([state[field] for state in states]) for field in (0, 1, 3))
        return position, velocity, torque

    def tool(self) -> Pose:
        """Return the pose of the tool, which is between the finger tips."""
        state = self._client.getLinkState(self._body, self._tool, computeForwardKinematics=True)
        return Pose(*state[4:6])

    def _info(self, index: int) -> tuple:  # of PyBullet, which has no types
        return self._client.getJointInfo(self._body, index)


def urdf() -> str:
    """Return the robot's URDF, with the meshes as local files."""
    return FILE.read_text().replace("package://", f"file://{FILE.parent}/")
