"""A robot's task: its observations, commands and rewards, as given by a configuration."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from rkhs_ros.base.settings import Entry, Settings, build, entries, setting
from rkhs_ros.base.validation import require
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.robot.commands import Commands
from rkhs_ros.robot.reset import Reset
from rkhs_ros.robot.rules import End, Reward, Rules
from rkhs_ros.robot.sensors import Sensor, Sensors

NAME = re.compile(r"[A-Za-z]\w*")


@dataclass(frozen=True)
class RobotTask(Settings):
    """A robot's task.

    Attributes:
        sensors: the sensors whose values are observed.
        rules: the functions named by the settings.
    """

    task: str = setting("robot", "name of the task in policies and recordings")
    period: float = setting(0.02, "seconds per step", minimum=0.001, maximum=3600.0)
    action_deadline: float = setting(
        0.5,
        "fraction of the period within which an action must arrive; else the last command is held",
        minimum=0.01,
        maximum=1.0,
    )
    misses_allowed: int = setting(
        2, "missed action deadlines per episode; one more discards the episode", minimum=0, maximum=10**6
    )
    stale_after: float = setting(0.1, "seconds after which a sensor's message is stale", minimum=1e-3, maximum=3600.0)
    learner_timeout: float = setting(
        0.2,
        "seconds without a heartbeat of the learner after which the episode is discarded",
        minimum=0.01,
        maximum=3600,
    )
    veto_window: float = setting(
        0.0, "seconds to hold back a completed episode, during which ~/veto discards it", minimum=0, maximum=3600
    )
    action: Commands = Commands()
    reward: Reward = Reward()
    end: End = End()
    reset: Reset = Reset()
    sensors: Sensors = field(default=Sensors({}, 0.1))

    @cached_property
    def rules(self) -> Rules:
        """The functions that compute the reward and decide whether the episode ends.

        Raises:
            ValueError: a function cannot be imported.
        """
        return Rules.of(self.reward, self.end)

    @property
    def spaces(self) -> Spaces:
        """The observation and action spaces, with the names of their dimensions."""
        joints = self.reset.home.joints
        named = self.action.names(joints) if len(joints) == self.action.dimension else ()
        bounds = np.array(self.action.minimum), np.array(self.action.maximum)
        return Spaces((self.sensors.dimension,), *bounds, self.sensors.names, named)

    def entries(self) -> Iterator[Entry]:
        """Yield the settings by their dotted names."""
        yield from entries(self)
        for name, sensor in self.sensors:
            yield from entries(sensor, f"sensors.{name}.")


def robot_task_from(tree: Mapping[str, Any]) -> RobotTask:
    """Return the task of a configuration's robot section.

    Raises:
        ValueError: an unknown key, an invalid value, or a function that cannot be imported.
    """
    require(isinstance(tree, Mapping), "robot", "a section of keys", repr(tree))
    sections = tree.get("sensors", {})
    require(isinstance(sections, Mapping) and len(sections) > 0, "sensors", "a section for each sensor", sections)
    by_name = {str(name): _sensor(str(name), section) for name, section in sections.items()}
    task = build(RobotTask, {key: value for key, value in tree.items() if key != "sensors"})
    require(bool(NAME.fullmatch(task.task)), "task", "a name of letters, digits and _", repr(task.task))
    require(bool(task.reward.function or task.reward.topic), "reward", "a function or a topic", "neither")
    if "home" in task.reset.steps:
        joints = task.reset.home.joints
        require(
            len(joints) == task.action.dimension,
            "reset.home.joints",
            f"{task.action.dimension}, one for each number of a command",
            ", ".join(joints),
        )
    task = replace(task, sensors=Sensors(by_name, task.stale_after))
    _ = task.rules  # raises if a function cannot be imported
    return task


def _sensor(name: str, section: Any) -> Sensor:
    require(bool(NAME.fullmatch(name)), "sensors", "names of letters, digits and _", repr(name))
    try:
        return build(Sensor, section, f"sensors.{name}.")
    except ValueError as error:
        text = str(error)
        raise ValueError(text if f"sensors.{name}" in text else f"sensors.{name}: {text}") from error
