"""Validation of a gate's settings, and the rules derived from them and a URDF."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from rkhs_ros.base.settings import build
from rkhs_ros.robot.gate_settings import FLOAT, TRAJECTORY, TWIST, GateSettings, rules
from rkhs_ros.robot.gate_state import Rules
from rkhs_ros.robot.urdf import located

URDF = """<robot name="arm">
  <link name="base"/>
  <joint name="turn" type="revolute"><limit lower="-1.5" upper="2.5" effort="30" velocity="2"/></joint>
  <joint name="wheel" type="continuous"><limit effort="5" velocity="10"/></joint>
  <joint name="bolt" type="prismatic"><limit effort="5" velocity="1"/></joint>
  <joint name="fixed" type="fixed"/>
  <joint name="bad" type="revolute"><limit lower="-1" upper="x" effort="5" velocity="1"/></joint>
</robot>"""
EFFORT = {
    "joints": ["motor"],
    "command": {"topic": "effort_controller/commands", "kind": "effort"},
    "limits": {"minimum": [-3.0], "maximum": [3.0]},
    "hold": {"stiffness": 20.0, "damping": 5.0},
}
POSITION = {
    "joints": ["turn", "wheel"],
    "command": {"topic": "commands", "kind": "position"},
    "limits": {"minimum": -1.0, "maximum": [1.0, 2.0], "velocity": 1.0, "acceleration": 5.0},
}

BASE = {
    "joints": ["linear.x", "angular.z"],
    "sensor": {"topic": ""},
    "command": {"topic": "cmd_vel", "type": TWIST, "kind": "velocity"},
    "limits": {"minimum": [-0.2, -1.0], "maximum": [0.5, 1.0], "acceleration": [0.5, 2.0]},
}
ROOT = Path(__file__).parents[3]


def merged(tree: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a tree with some values changed; None removes a value."""
    result = dict(tree)
    for name, value in changes.items():
        result[name] = merged(result.get(name, {}), value) if isinstance(value, dict) else value
    return {name: value for name, value in result.items() if value is not None}


def rules_from(tree: Mapping[str, Any], **changes: Any) -> Rules:
    return rules(build(GateSettings, merged(tree, changes)))


@pytest.fixture
def urdf(tmp_path: Path) -> str:
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    return str(file)


def test_one_number_applies_to_all_joints_and_an_omitted_limit_is_none() -> None:
    limits = rules_from(POSITION).limits
    np.testing.assert_array_equal(limits.minimum, [-1.0, -1.0])
    np.testing.assert_array_equal(limits.maximum, [1.0, 2.0])
    np.testing.assert_array_equal(limits.step, [np.inf, np.inf])
    made = rules_from(EFFORT, limits={"step": 0.0}, sensed={"velocity": 0.0})
    assert (made.limits.step[0], made.sensed.velocity[0]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("tree", "changes", "message"),
    [
        (EFFORT, {"joints": None}, "joints: expected the names of the joints, got none"),
        (EFFORT, {"joints": ["a", "a"], "limits": {"minimum": -1.0}}, "joints: expected unique names"),
        (EFFORT, {"command": {"topic": None}}, "command.topic: expected the topic"),
        (EFFORT, {"limits": None}, "limits.minimum: expected a limit for each joint (required for effort"),
        (EFFORT, {"limits": {"minimum": 1.0}}, "limits: expected minimum <= 0 <= maximum"),
        (EFFORT, {"limits": {"step": 1e-12}}, "limits.step: expected 0, or from 1e-09"),
        (EFFORT, {"limits": {"step": [1.0, 2.0]}}, "limits.step: expected 1 number, got 2"),
        (EFFORT, {"limits": {"acceleration": 1.0}}, "limits.acceleration: expected no value for effort commands"),
        (EFFORT, {"hold": None}, "hold.stiffness: expected gains"),
        (EFFORT, {"sensor": {"topic": ""}}, "sensor: expected a topic with position, velocity"),
        (EFFORT, {"sensed": {"minimum": 1.0, "maximum": 0.0}}, "sensed: expected minimum <= maximum"),
        (EFFORT, {"stop_topics": ["a", "a"]}, "stop_topics: expected unique names"),
        (EFFORT, {"period": 0.5}, "period: expected at most command_timeout"),
        (EFFORT, {"command": {"kind": None}}, "command.kind: expected position or velocity or effort"),
        (EFFORT, {"command": {"type": TRAJECTORY}}, "command.kind: expected position, got 'effort'"),
        (POSITION, {"command": {"type": FLOAT}}, "joints: expected 1 name for std_msgs/msg/Float64, got 2"),
        (POSITION, {"limits": {"velocity": None}}, "limits.velocity: expected a limit for each joint"),
        (POSITION, {"hold": {"damping": 1.0}}, "hold.damping: expected none (used for effort commands only)"),
        (POSITION, {"command": {"type": TWIST, "kind": "velocity"}}, "joints: expected some of linear.x"),
        (BASE, {"sensor": None}, "sensor.topic: expected '' for a Twist, which has no joints, got joint_states"),
        (BASE, {"sensed": {"velocity": 1.0}}, "sensor: expected a topic with velocity, got none"),
        (POSITION, {"limits": {"urdf": "nowhere.urdf"}}, "nowhere.urdf"),
    ],
)
def test_invalid_settings_are_refused_in_one_line(
    tree: Mapping[str, Any], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises((ValueError, FileNotFoundError)) as refusal:
        rules_from(tree, **changes)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_documented_parameters_are_valid() -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "gate.md").read_text(), flags=re.DOTALL)
    made = rules_from(yaml.safe_load(block)["/**/gate"]["ros__parameters"])
    assert made.limits.step[0] == 6.0


def test_urdf_limits_of_positions_can_be_tightened_but_not_widened(urdf: str) -> None:
    urdf_range = {"urdf": urdf, "minimum": None, "maximum": None}
    given = urdf_range | {"maximum": [1.0, 0.0], "velocity": None}
    limits = rules_from(POSITION, joints=["turn", "bolt"], limits=given).limits
    np.testing.assert_array_equal(limits.minimum, [-1.5, 0.0])
    np.testing.assert_array_equal(limits.maximum, [1.0, 0.0])  # the omitted range of the bolt is 0
    np.testing.assert_array_equal(limits.velocity, [2.0, 1.0])
    with pytest.raises(ValueError, match=r"limits.velocity: expected limits no wider than the URDF's, \[2. 1.\]"):
        rules_from(POSITION, joints=["turn", "bolt"], limits=urdf_range | {"velocity": 1.5})
    with pytest.raises(ValueError, match=r"limits.minimum: expected a limit"):  # the wheel turns freely
        rules_from(POSITION, limits=given)


def test_a_urdf_is_found_in_a_ros_or_python_package(urdf: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    share = tmp_path / "prefix" / "share" / "my_robot"
    share.mkdir(parents=True)
    (share / "arm.urdf").write_text(Path(urdf).read_text())
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'prefix'}")
    assert located("package://my_robot/arm.urdf") == share / "arm.urdf"
    assert located(urdf) == Path(urdf)
    assert located("package://sim_nodes/robots/arm.py").is_file()
    with pytest.raises(ValueError, match="urdf: expected an installed package 'your_robot'"):
        located("package://your_robot/arm.urdf")


def test_a_urdf_limits_sensed_states_that_commands_do_not_bound(urdf: str) -> None:
    none = {"urdf": urdf, "minimum": None, "maximum": None}
    made = rules_from(EFFORT, joints=["turn", "wheel"], limits=none)
    np.testing.assert_array_equal(made.limits.maximum, [30.0, 5.0])
    np.testing.assert_array_equal(made.limits.minimum, [-30.0, -5.0])
    np.testing.assert_array_equal(made.sensed.minimum, [-1.5, -np.inf])
    np.testing.assert_array_equal(made.sensed.velocity, [2.0, 10.0])
    assert not np.isfinite(made.sensed.effort).any()
    assert not rules_from(POSITION, joints=["turn", "bolt"], limits=none).sensed.fields
    with pytest.raises(ValueError, match=r"sensed.maximum: expected limits no wider"):
        rules_from(EFFORT, joints=["turn", "wheel"], limits=none, sensed={"maximum": 3.0})


@pytest.mark.parametrize(
    ("joint", "message"),
    [("turm", "did you mean 'turn'"), ("fixed", "expected a limit, got none"), ("bad", "expected a number for upper")],
)
def test_a_urdf_without_limits_of_a_joint_is_refused(urdf: str, joint: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rules_from(POSITION, joints=["turn", joint], limits={"urdf": urdf})
