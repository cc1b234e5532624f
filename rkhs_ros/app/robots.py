"""Configurations with a robot: what is looked at before anything is started."""

from __future__ import annotations

from rkhs_ros.base.validation import require
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.robot.task import RobotTask, robot_task_from
from rkhs_ros.runs.config import Config


def spaces_of_robot(config: Config) -> Spaces:
    """Return the spaces of a robot's task, whose configuration is sound.

    Raises:
        ValueError: a section has an unknown key or a value that does not fit; or the sections do not fit together.
    """
    nodes = config.environment.nodes
    task = _named("robot", nodes["robot"])
    require(config.training.simulators == 1, "simulators", "1, as there is one robot", config.training.simulators)
    timeout = nodes["gate"].get("command_timeout", 0.2)
    silence = (task.misses_allowed + 1 + task.action_deadline) * task.period
    good = isinstance(timeout, int | float) and silence < timeout
    what = "(robot.misses_allowed + 1 + robot.action_deadline) * robot.period"
    require(good, what, f"less than gate.command_timeout, {timeout:g} s", f"{silence:g} s")
    return task.spaces


def _named(name: str, section: object) -> RobotTask:
    try:
        return robot_task_from(section)  # type: ignore[arg-type]  # which it looks at
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
