"""The robot and the door in PyBullet, which simulates motions of the arm and the gripper with contacts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files

import numpy as np

from sim_nodes.bullet import connected, pybullet
from sim_nodes.envs.scene import Array, Body
from sim_nodes.pr2.motion import FINGERS, MOVING, RATE, TIPS, Motion, arm_chain, finger_angle, gap, rotation_about

CONTROL_RATE = 60  # Hz
SIMULATION_RATE = 120  # Hz
SOLVER_ITERATIONS = 30
CONTACT_CORRECTION = 0.5  # fraction of a penetration corrected per step: the fingers sink less than 1 mm into the lever
STIFFNESS = 20.0  # 1/s: commanded speed of a motor per position error
GRIP_TORQUE = 7.0  # N m per finger, about 77 N at its tip, so that the lever does not slip
FINGER_FRICTION = 1.0
# Inertia of the gripper's motor behind its gears, kg m2. With their own mass only, the fingers would be too light
# relative to the door for the solver to reach the grip torque.
GEARED_INERTIA = 0.01
SHUT = math.radians(0.5)  # angle of the door below which the latch engages
UNLATCHED = math.radians(30.0)  # angle of the lever above which the latch releases
OPENED = math.radians(5.0)  # angle of the door that counts as success
# Hinges, seal and closer: 22 N at the free edge, the greatest force that ADA 404.2.9 allows indoors. A gripper that
# holds the lever pulls harder; a single finger that slides along it does not.
HINGE_FRICTION = 20.0
RETURN_SPEED = 5.0  # of the released lever
LATCH_TORQUE = 2000.0
LEVER_FRICTION, PANEL_FRICTION = 0.6, 0.5  # of the surfaces
HINGE_NAMES = ("door_hinge", "door_lever")
JOINT_NAMES = tuple(joint.name for joint in MOVING)
VELOCITY = np.array([joint.velocity for joint in MOVING])
EFFORT = np.array([GRIP_TORQUE if joint.name.endswith("_finger_joint") else joint.effort for joint in MOVING])
_ARM, _FINGERS, _TIPS = slice(0, 7), slice(7, 9), slice(9, 11)
_FORCES = EFFORT.tolist()


@dataclass(frozen=True)
class Trajectory:
    """An executed motion, at its k knots."""

    positions: Array  # of the joints `JOINT_NAMES`, shape (k, 11)
    door: Array  # angle, rad, shape (k,)
    lever: Array  # angle, rad, shape (k,)
    tool: Array  # position in the world, shape (k, 3)
    openings: Array  # metres between the finger tips, shape (k,)


class World:
    """A simulated PR2 in front of a door.

    Owns a PyBullet client. Episodes are independent of each other.
    """

    def __init__(self) -> None:
        self.client = connected(SIMULATION_RATE, numSolverIterations=SOLVER_ITERATIONS, contactERP=CONTACT_CORRECTION)
        self._robot, self._door = (self._load(name) for name in ("pr2.urdf", "door.urdf"))
        self._joints = self._indices(self._robot, JOINT_NAMES)
        self._hinge, self._lever = self._indices(self._door, HINGE_NAMES)
        self._visuals = [each for body in (self._robot, self._door) for each in self.client.getVisualShapeData(body)]
        self._set_surfaces()
        self._still = self.client.saveState()
        self._chain = arm_chain()

    def close(self) -> None:
        """Disconnect the client."""
        if self.client.isConnected():
            self.client.disconnect()

    def bodies(self) -> list[Body]:
        """Return the visible boxes of the robot and the door."""
        paints = (bytes(round(255 * part) for part in visual[7][:3]) for visual in self._visuals)
        return [Body("box", visual[3], f"#{paint.hex()}") for visual, paint in zip(self._visuals, paints, strict=True)]

    def poses(self, positions: Array, angles: Array, base: Array) -> tuple[Array, Array]:
        """Return the positions (k, boxes, 3) and orientations (k, boxes, 4), w first, of the visible boxes."""
        moments = []
        for robot, door in zip(positions, angles, strict=True):
            self._place(robot, door, base)
            moments.append([self._pose(*visual[:2], *visual[5:7]) for visual in self._visuals])
        poses = np.array(moments)
        return poses[..., :3], np.roll(poses[..., 3:], 1, axis=-1)

    def run(self, motion: Motion, base: Array) -> Trajectory:
        """Execute a motion, starting with a shut door, with the robot at a base x, y in metres, yaw in radians."""
        self._reset(motion, base)
        targets, speeds = _commands(motion)
        ticks = CONTROL_RATE // RATE
        states = [self._knot()]
        for knot in range(len(motion.arm) - 1):
            for tick in range(knot * ticks, (knot + 1) * ticks):
                self._control(targets[tick], speeds[tick])
            states.append(self._knot())
        positions, angles = np.split(np.array(states), [11], axis=1)
        tool = self._chain.forward(positions[:, _ARM])[0] @ rotation_about((0.0, 0.0, 1.0), base[2:])[0].T
        openings = gap(positions[:, _FINGERS]).mean(axis=1)
        door, lever = angles.T
        return Trajectory(positions, door, lever, tool + np.array([base[0], base[1], 0.0]), openings)

    def _reset(self, motion: Motion, base: Array) -> None:
        self.client.restoreState(self._still)
        self._place(knots(motion)[0], np.zeros(2), base)
        self._set_latch(True)
        self._measure()

    def _place(self, robot: Array, door: Array, base: Array) -> None:
        client = self.client
        client.resetBasePositionAndOrientation(
            self._robot, (base[0], base[1], 0.0), client.getQuaternionFromEuler((0.0, 0.0, base[2]))
        )
        for index, angle in zip(self._joints, robot, strict=True):
            client.resetJointState(self._robot, index, angle)
        for index, angle in zip((self._hinge, self._lever), door, strict=True):
            client.resetJointState(self._door, index, angle)

    def _pose(self, body: int, link: int, place: Sequence[float], turn: Sequence[float]) -> list[float]:
        """Return the position and the quaternion, w last, of a box at a pose in the frame of a link."""
        if link < 0:
            frame = self.client.getBasePositionAndOrientation(body)
        else:
            frame = self.client.getLinkState(body, link, computeForwardKinematics=True)[4:6]
        return [number for part in self.client.multiplyTransforms(*frame, place, turn) for number in part]

    def _control(self, targets: Array, speeds: Array) -> None:
        """Command the motors' speeds within their limits, and simulate until the next command."""
        targets[_TIPS], speeds[_TIPS] = self._q[_FINGERS], self._v[_FINGERS]  # mechanical coupling
        wanted = np.minimum(np.maximum(speeds + STIFFNESS * (targets - self._q), -VELOCITY), VELOCITY)
        self.client.setJointMotorControlArray(
            self._robot, self._joints, pybullet.VELOCITY_CONTROL, targetVelocities=wanted.tolist(), forces=_FORCES
        )
        for _ in range(SIMULATION_RATE // CONTROL_RATE):
            self._simulate()
        self._measure()

    def _simulate(self) -> None:
        client = self.client
        (opened, *_), (turned, *_) = client.getJointStates(self._door, (self._hinge, self._lever))
        held = latched(self._latched, opened, turned)
        if held != self._latched:
            self._set_latch(held)
        # Simulate the spring by a motor with limited force: exact while the lever is held, and without overshoot.
        torque = 1.2 + 1.5 * max(turned, 0.0)  # N m
        client.setJointMotorControl2(
            self._door, self._lever, pybullet.VELOCITY_CONTROL, targetVelocity=-RETURN_SPEED, force=torque
        )
        client.stepSimulation()

    def _set_latch(self, held: bool) -> None:
        """Hold the hinge by the latch, or by friction only."""
        self._latched = held
        control = {"controlMode": pybullet.POSITION_CONTROL, "targetPosition": 0.0, "force": LATCH_TORQUE}
        free = {"controlMode": pybullet.VELOCITY_CONTROL, "targetVelocity": 0.0, "force": HINGE_FRICTION}
        self.client.setJointMotorControl2(self._door, self._hinge, **(control if held else free))

    def _measure(self) -> None:
        states = self.client.getJointStates(self._robot, self._joints)
        self._q, self._v = np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def _knot(self) -> Array:
        angles = [state[0] for state in self.client.getJointStates(self._door, (self._hinge, self._lever))]
        return np.concatenate([self._q, angles])

    def _load(self, name: str) -> int:
        with as_file(files(__package__).joinpath(name)) as path:
            return int(self.client.loadURDF(str(path), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE))

    def _indices(self, body: int, names: Sequence[str]) -> list[int]:
        found = {self.client.getJointInfo(body, i)[1].decode(): i for i in range(self.client.getNumJoints(body))}
        return [found[name] for name in names]

    def _set_surfaces(self) -> None:
        tips = self._indices(self._robot, [joint.name for joint in (*FINGERS, *TIPS)])
        surfaces = [(self._robot, tip, FINGER_FRICTION) for tip in tips]
        surfaces += [(self._door, self._lever, LEVER_FRICTION), (self._door, self._hinge, PANEL_FRICTION)]
        for body, link, friction in surfaces:
            self.client.changeDynamics(body, link, lateralFriction=friction, restitution=0.0)
        for tip in tips:
            self.client.changeDynamics(self._robot, tip, localInertiaDiagonal=(GEARED_INERTIA,) * 3)


def latched(before: bool, door: float, lever: float) -> bool:
    """Return whether the latch holds the door, given its previous state and the angles."""
    return lever <= UNLATCHED and (before or door < SHUT)


def _commands(motion: Motion) -> tuple[Array, Array]:
    """Return the desired positions and velocities at the end of each control period, each of shape (ticks, 11)."""
    angles, ticks = knots(motion), CONTROL_RATE // RATE
    part = (np.arange(1, ticks + 1) / ticks)[:, None]
    steps = np.diff(angles, axis=0)[:, None, :]
    targets = (angles[:-1, None, :] + part * steps).reshape(-1, angles.shape[1])
    return targets, np.repeat(steps[:, 0] * RATE, ticks, axis=0)


def knots(motion: Motion) -> Array:
    """Return the angles of the joints `JOINT_NAMES` at the knots of a motion, shape (k, 11)."""
    return np.concatenate([motion.arm, np.repeat(finger_angle(motion.openings)[:, None], 4, axis=1)], axis=1)
