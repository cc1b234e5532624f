"""The simulated robots as environments in one process, in the robots' time and without ROS.

Commands, limits, rewards and delays are those of the configurations in config/. The gate limits commands as it does
between the nodes, but stops nothing. An episode starts with a new robot, at rest at its home position.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from rkhs_ros.base.settings import build
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_settings import GateSettings, rules
from rkhs_ros.robot.limits import POSITION, Setpoint, advance, braking, rest_at
from rkhs_ros.robot.task import robot_task_from
from rkhs_ros.runs.config import load_config
from sim_nodes.robots import settings_of
from sim_nodes.robots.arm import ArmReadings, ArmRobot
from sim_nodes.robots.drives import JointCommand
from sim_nodes.robots.motor_pendulum import MotorPendulumRobot
from sim_nodes.robots.robot import Hardware, JointReadings

CONFIG = Path(__file__).parents[1] / "config"
SEEDS = 2**31


class SimulatedRobot(gymnasium.Env[Array, Array]):
    """A robot of a configuration. Owns the robot, its last set point and the last observation.

    Args:
        name: name of the configuration.
        robot_of: returns the robot with given settings.
        observed: returns the observation in the robot's readings.
    """

    def __init__(self, name: str, robot_of: Callable[[Any], Any], observed: Callable[[Any], tuple[float, ...]]) -> None:
        nodes = load_config(CONFIG / f"{name}.yaml").environment.nodes
        self._gate = build(GateSettings, nodes["gate"])
        self._limits = rules(self._gate).limits
        self._task = robot_task_from(nodes["robot"])
        self._robot, self._robot_of, self._observed = dict(nodes["simulated_robot"]), robot_of, observed
        self._kind = self._robot.pop("robot")
        spaces = self._task.spaces
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, spaces.observation_shape, np.float64)
        self.action_space = gymnasium.spaces.Box(spaces.action_low, spaces.action_high, dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode with a new robot."""
        super().reset(seed=seed)
        settings = settings_of(self._kind, self._robot | {"seed": int(self.np_random.integers(SEEDS))})
        self._speed, self._hardware, self._time = settings.speed, Hardware(self._robot_of(settings)), 0.0
        home = np.array(self._task.reset.home.position)
        self._motion = rest_at(home if self._limits.kind == POSITION else np.zeros(self._limits.joints))
        self._now = np.zeros(self.observation_space.shape)
        while not self._now.any():
            self._wait()
        return self._now.copy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Command the robot for one period of the task."""
        before, goal = self._now, self._task.action.command(action)
        for _ in range(round(self._task.period / self._gate.period)):
            self._motion = advance(self._limits, self._gate.period, self._motion, goal)
            self._hardware.send(self._time, self._sent(self._motion))
            self._wait()
        executed = self._task.action.action(goal)
        return self._now.copy(), self._task.reward.of(0.0, before, executed, self._now), False, False, {}

    def _wait(self) -> None:
        """Advance by one period of the gate."""
        self._time += self._speed * self._gate.period
        for _, readings in self._hardware.advance(self._time):
            self._now = np.array(self._observed(readings))

    def _sent(self, motion: Setpoint) -> Any:
        if self._limits.kind != POSITION:
            return motion.value
        period = self._gate.period
        points = [(period + time, tuple(values)) for time, values in braking(self._limits, period, motion)]
        times, positions = zip(*points, strict=True)
        return JointCommand(self._gate.joints, tuple(self._speed * time for time in times), positions)


def _angle(readings: JointReadings) -> tuple[float, ...]:
    return (*readings.positions, *readings.velocities)


def _mark_and_tool(readings: ArmReadings) -> tuple[float, ...]:
    return (*readings.mark[1:], *readings.tool.position)


for _id, _horizon, _arguments in (
    ("MotorPendulum", 100, ("robot_pendulum", MotorPendulumRobot, _angle)),
    ("Arm", 30, ("robot_arm", ArmRobot, _mark_and_tool)),
):
    gymnasium.register(f"robots/{_id}-v0", partial(SimulatedRobot, *_arguments), max_episode_steps=_horizon)
