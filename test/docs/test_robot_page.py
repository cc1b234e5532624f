"""The examples of the robot pages are valid configurations, and the table of settings is complete."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.base.settings import build
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.robot.gate_settings import GateSettings
from rkhs_ros.robot.sensors import Sensor, Sensors
from rkhs_ros.robot.task import RobotTask, robot_task_from
from test.docs.pages import ROOT

PAGE = (ROOT / "docs" / "your_robot.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)


def test_the_steps_form_one_valid_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = [content for language, content in BLOCKS if language == "yaml"]
    begin = next(content for content in steps if content.startswith("/**/robot"))
    parts = [content for content in steps if content.startswith(("    action:", "    reward:", "    reset:"))]
    assert len(parts) == 3
    rules = next(content for language, content in BLOCKS if language == "python")
    (tmp_path / "my_rules.py").write_text(rules)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    task = robot_task_from(loaded("".join([begin, *parts]))["/**/robot"]["ros__parameters"])
    assert task.sensors.dimension == 9
    assert task.reward.of(0.0, *[_observation(0.4, 0.6)] * 3) == 1.0
    assert task.end.is_reached(*[_observation(0.4, 0.0)] * 3)


def _observation(x: float, z: float) -> np.ndarray:
    return np.array([0.0] * 7 + [x, z])


def test_the_gates_for_ros2_control_are_valid() -> None:
    steps = [content for language, content in BLOCKS if language == "yaml"]
    gate = loaded(next(content for content in steps if content.startswith("/**/gate")))["/**/gate"]["ros__parameters"]
    other = loaded(next(content for content in steps if content.startswith("    command:")))
    assert build(GateSettings, gate).command.kind == "position"
    assert build(GateSettings, gate | other).command.type == "trajectory_msgs/msg/JointTrajectory"


def test_the_table_lists_all_settings() -> None:
    task = RobotTask(sensors=Sensors({"NAME": Sensor()}, 0.1))
    page = (ROOT / "docs" / "robot_node.md").read_text()
    table = page[page.index("## Settings") : page.index("## Discarded")]
    listed = set()
    for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE):
        prefix = ""
        for name in re.findall(r"`([\w.]+)`", row):
            full = prefix + name if name.startswith(".") else name
            prefix = full.rpartition(".")[0]
            listed.add(full)
    assert listed == {entry.name for entry in task.entries()}
