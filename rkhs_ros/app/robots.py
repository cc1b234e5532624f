"""Configurations with a robot: what is looked at before anything is started."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rkhs_ros.base.settings import build
from rkhs_ros.base.validation import require
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.robot.gate_settings import GateSettings, rules
from rkhs_ros.robot.task import RobotTask, robot_task_from
from rkhs_ros.runs.config import Config
from sim_nodes.robots.kinds import DEFAULT, settings_of


def check_robot(config: Config) -> Spaces:
    """Check the sections of a configuration with a robot; return the spaces of its task.

    Raises:
        ValueError: a section has an unknown key or a value that does not fit, or the sections do not fit together.
        OSError: a URDF cannot be read.
    """
    nodes = config.environment.nodes
    with _named("robot"):
        task = robot_task_from(nodes["robot"])
    with _named("gate"):
        gate = build(GateSettings, nodes["gate"])
        rules(gate)
    if "practice_robot" in nodes:
        with _named("practice_robot"):
            section = dict(nodes["practice_robot"])
            settings_of(str(section.pop("robot", DEFAULT)), section)
    require(config.training.simulators == 1, "simulators", "1, as there is one robot", config.training.simulators)
    _check_together(task, gate)
    return task.spaces


def _check_together(task: RobotTask, gate: GateSettings) -> None:
    """Raise ValueError where commands and joints differ, or the gate would stop before an episode is void."""
    size = task.action.dimension
    require(size == len(gate.joints), "robot.action", f"{len(gate.joints)}, one for each joint of the gate", size)
    kind, homes = gate.command.kind, "home" in task.reset.steps
    require(task.action.kind == kind or not homes, "robot.action.kind", f"the gate's, {kind}", task.action.kind)
    joints = task.reset.home.joints
    ours, theirs = ", ".join(joints), ", ".join(gate.joints)
    require(joints == gate.joints or not homes, "robot.reset.home.joints", f"the gate's, {theirs}", ours)
    longest = (task.misses_allowed + 1 + task.action_deadline) * task.period
    what = "(robot.misses_allowed + 1 + robot.action_deadline) * robot.period"
    good = longest < gate.command_timeout
    require(good, what, f"less than gate.command_timeout, {gate.command_timeout:g} s", f"{longest:g} s")


@contextmanager
def _named(section: str) -> Iterator[None]:
    """Say which section is refused."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{section}: {error}") from error
