"""Configurations with a robot: what is looked at before anything is started."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from rkhs_ros.base.ros import missing_ros
from rkhs_ros.base.settings import build
from rkhs_ros.base.validation import require
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.robot.gate_settings import GateSettings, rules
from rkhs_ros.robot.limits import Limits
from rkhs_ros.robot.task import RobotTask, robot_task_from
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.report import last_policy
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
        limits = rules(gate)
    if "simulated_robot" in nodes:
        with _named("simulated_robot"):
            section = dict(nodes["simulated_robot"])
            settings_of(str(section.pop("robot", DEFAULT)), section)
    require(config.training.simulators == 1, "simulators", "1, as there is one robot", config.training.simulators)
    _check_together(task, gate)
    if not missing_ros():
        from rkhs_ros.nodes.robot.robot_topics import check_topics  # here, since others than robots do without ROS

        check_topics(task, gate)
    for line in ineffective_actions(task, limits.limits):
        print(f"warning: {line}", file=sys.stderr)
    return task.spaces


def default_domain(config: Config) -> str | None:
    """Return the ROS domain in which the nodes of a real robot are, unless the environment says otherwise."""
    nodes = config.environment.nodes
    return "0" if nodes and "simulated_robot" not in nodes else None


def robot_of(path: Path) -> Config | None:
    """Return the configuration of a run on a robot; None of other runs and policies.

    Args:
        path: the run's folder, or a policy file in it.

    Raises:
        ValueError: the folder holds no policy yet, or its configuration is none.
    """
    policy = last_policy(path) if path.is_dir() else path
    file = policy.parent / "config.yaml"
    config = load_config(file) if file.is_file() else None
    return config if config is not None and config.environment.nodes else None


def ineffective_actions(task: RobotTask, limits: Limits) -> Iterator[str]:
    """Say in a line each which actions can have no effect, as the gate lets none of their commands differ."""
    ends = [task.action.command(np.array(bound)) for bound in (task.action.minimum, task.action.maximum)]
    low, high = limits.bounds()
    least, greatest = np.clip(np.sort(ends, axis=0), low, high)
    stays = np.minimum(limits.rate, limits.step) == 0.0
    for number in np.flatnonzero((least == greatest) | stays):
        limit = "changes of 0" if stays[number] else f"commands from {low[number]:g} to {high[number]:g}"
        yield f"robot.action: number {number} has no effect, for the gate's limits allow {limit}; it learns nothing"


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
