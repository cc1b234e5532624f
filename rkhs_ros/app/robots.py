"""Checks of a configuration with a robot before any node starts."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rkhs_ros.base.settings import build
from rkhs_ros.base.validation import missing_ros, prefixed, require
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.robot.gate_settings import GateSettings, rules
from rkhs_ros.robot.limits import Limits
from rkhs_ros.robot.task import RobotTask, robot_task_from
from rkhs_ros.runs.config import Config, load_config
from sim_nodes.robots import DEFAULT, settings_of


def check_robot(config: Config) -> Spaces:
    """Check the sections of a configuration with a robot, also against each other; return the spaces of its task."""
    nodes = config.environment.nodes
    with prefixed("robot"):
        task = robot_task_from(nodes["robot"])
    with prefixed("gate"):
        gate = build(GateSettings, nodes["gate"])
        limits = rules(gate)
    if "simulated_robot" in nodes:
        with prefixed("simulated_robot"):
            section = dict(nodes["simulated_robot"])
            settings_of(str(section.pop("robot", DEFAULT)), section)
    _check_together(task, gate)
    if not missing_ros():
        from rkhs_ros.nodes.robot.sensor_topics import check_topics  # here, since the import needs ROS

        check_topics(task)
    for line in ineffective_actions(task, limits.limits):
        print(f"warning: {line}", file=sys.stderr)
    return task.spaces


def default_domain(config: Config) -> str | None:
    """Return the default ROS domain: 0 for a real robot, None for a simulator or a simulated robot."""
    nodes = config.environment.nodes
    return "0" if nodes and "simulated_robot" not in nodes else None


def robot_of(path: Path) -> Config | None:
    """Return the configuration of a run on a robot, given by its folder or a policy file in it; None for others."""
    file = (path if path.is_dir() else path.parent) / "config.yaml"
    config = load_config(file) if file.is_file() else None
    return config if config is not None and config.environment.nodes else None


def ineffective_actions(task: RobotTask, limits: Limits) -> Iterator[str]:
    """Yield a warning for each action without effect, if the limits of the gate allow only one command for it."""
    ends = [task.action.command(np.array(bound)) for bound in (task.action.minimum, task.action.maximum)]
    low, high = limits.bounds()
    least, greatest = np.clip(np.sort(ends, axis=0), low, high)
    stays = np.minimum(limits.rate, limits.step) == 0.0
    for number in np.flatnonzero((least == greatest) | stays):
        limit = "changes of 0" if stays[number] else f"commands from {low[number]:g} to {high[number]:g}"
        yield f"robot.action: action {number} has no effect and cannot be learnt, since the gate's limits allow {limit}"


def _check_together(task: RobotTask, gate: GateSettings) -> None:
    """Raise ValueError if commands or joints differ, or if the gate stops before an episode is discarded."""
    size = task.action.dimension
    require(size == len(gate.joints), "robot.action", f"{len(gate.joints)}, one per joint of the gate", size)
    kind, homes = gate.command.kind, "home" in task.reset.steps
    require(task.action.kind == kind, "robot.action.kind", f"gate.command.kind, {kind}", task.action.kind)
    joints = task.reset.home.joints
    ours, theirs = ", ".join(joints), ", ".join(gate.joints)
    require(joints == gate.joints or not homes, "robot.reset.home.joints", f"gate.joints, {theirs}", ours)
    longest = (task.misses_allowed + 1 + task.action_deadline) * task.period
    what = "(robot.misses_allowed + 1 + robot.action_deadline) * robot.period"
    good = longest < gate.command_timeout
    require(good, what, f"less than gate.command_timeout, {gate.command_timeout:g} s", f"{longest:g} s")
