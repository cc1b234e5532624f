"""Simulated robots: processes that behave like hardware, in real time."""

from collections.abc import Mapping
from typing import Any

from rkhs_ros.base.settings import build
from rkhs_ros.base.validation import pick
from sim_nodes.robots.arm import ArmSettings
from sim_nodes.robots.motor_pendulum import MotorPendulumSettings
from sim_nodes.robots.robot import RobotSettings

DEFAULT = "motor_pendulum"
SETTINGS: dict[str, type[RobotSettings]] = {"motor_pendulum": MotorPendulumSettings, "arm": ArmSettings}


def settings_of(name: str, section: Mapping[str, Any]) -> RobotSettings:
    """Return the settings of a robot from a section of a parameter file, which has no other keys."""
    return build(pick(name, SETTINGS, "robot"), section)
