"""Configurations with a robot instead of a simulator."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.app.robots import check_robot
from rkhs_ros.base.yaml_text import dumped, loaded
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import resolved
from test.unit.conftest import Result, assert_refused

PENDULUM = Path(__file__).parents[3] / "config" / "robot_pendulum.yaml"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("robot.perod=1", "robot: unknown key 'perod', did you mean 'period'?"),
        ("gate.limits={}", "gate: "),
        ("simulated_robot.robot=motor_pendulun", "simulated_robot: unknown robot 'motor_pendulun', did you mean"),
        ("robot.misses_allowed=9", "less than gate.command_timeout, 0.3 s, got 0.525 s"),
        ("robot.action={minimum: [0.0, 0.0], maximum: [1.0, 1.0], kind: effort}", "reset.home.joints: expected 2"),
        ("robot.action.kind=velocity", "robot.action.kind: expected gate.command.kind, effort"),
        ("robot.reset.home.joints=[shoulder]", "robot.reset.home.joints: expected gate.joints, motor, got shoulder"),
        ("robot.reward={topic: score, type: std_msgs/msg/Float65}", "unknown message type 'std_msgs/msg/Float65'"),
        ("robot.sensors.motor={topic: a, type: sensor_msgs/msg/Imu, fields: [speed]}", "unknown field 'speed' of Imu"),
    ],
)
def test_invalid_sections_are_refused_before_any_node_starts(
    change: str, message: str, rkhs: Callable[..., Result]
) -> None:
    assert_refused(rkhs("train", PENDULUM, "--out", "run", "--set", change), message)
    assert not Path("run").exists()


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("/**/gate", "expected /**/robot and /**/gate, got no gate"),
        ("/**/learner", "expected /**/learner, which is required for robots, got none"),
    ],
)
def test_a_robot_needs_its_gate(section: str, message: str, tmp_path: Path) -> None:
    document = loaded(PENDULUM.read_text())
    del document[section]
    (tmp_path / "robot.yaml").write_text(str(document))
    with pytest.raises(ValueError, match="expected") as refusal:
        load_config(tmp_path / "robot.yaml")
    assert message in str(refusal.value)


@pytest.mark.parametrize("missing", ["simulated robot", "arms_itself"])
def test_only_an_operator_ends_the_stops_of_a_real_robot(tmp_path: Path, missing: str) -> None:
    document = loaded(resolved(load_config(PENDULUM)))
    if missing == "arms_itself":
        del document["/**/gate"]["ros__parameters"]["arms_itself"]
    else:
        del document["/**/simulated_robot"]
    file = tmp_path / "parameters.yaml"
    file.write_text(dumped(document))
    config = load_config(file)
    written = loaded(write_parameters(config, file).read_text())
    assert load_config(file).training == config.training  # the learner's section contains the environment
    assert written["/**/robot"]["ros__parameters"]["simulated"] is False


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ("minimum: [0.0], maximum: [0.0]", "allow commands from 0 to 0"),
        ("minimum: [-3.0], maximum: [3.0], step: [0.0]", "allow changes of 0"),
        ("minimum: [-3.0], maximum: [3.0], step: [0.1]", ""),
    ],
)
def test_an_action_without_effect_is_reported_in_one_line(
    limits: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    check_robot(load_config(PENDULUM, [f"gate.limits={{{limits}}}"]))
    err = capsys.readouterr().err
    assert len(err.splitlines()) == bool(words)
    assert words in err
