"""``rkhs train`` of a practice robot, with all its nodes, and what it leaves to go on from."""

from collections.abc import Callable
from pathlib import Path

import pytest
from std_srvs.srv import Trigger

from rkhs_interfaces.srv import DescribeTask
from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from test.ros.conftest import Probe, Process
from test.ros.robot_bench import CONFIG, QUICK

pytestmark = pytest.mark.clock

Start = Callable[..., Process]


def test_it_learns_on_a_practice_robot_and_goes_on_where_it_was_left(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    command = ("rkhs", "train", CONFIG, "--quiet", "--out", folder, "--set", *QUICK, "iterations=1")
    code, out, err = start(*command).finish()
    assert (code, "error" in err) == (0, False), err
    assert out.startswith("Learnt motor_pendulum in 2 episodes")
    journal = folder / "checkpoints" / "episodes"
    first = {file.name: file.read_bytes() for file in journal.glob("*_steps_40.npz")}
    assert len(first) == 2
    assert load_config(folder / "config.yaml").environment.nodes["robot"]["period"] == 0.01
    code, _, err = start("rkhs", "train", "--quiet", "--resume", folder, "--iterations", 2).finish()
    assert code == 0, err
    assert [row.episodes for row in Curve(folder / "curve.csv").rows()] == [2, 4]
    assert {name: (journal / name).read_bytes() for name in first} == first


def test_a_real_robot_waits_for_a_person_to_arm_it(start: Start, tmp_path: Path, probe: Probe) -> None:
    document = load_config(CONFIG, (*QUICK, "iterations=1")).parameters()
    practice = tmp_path / "practice.yaml"
    practice.write_text(dumped({"/**/practice_robot": document.pop("/**/practice_robot")}))
    config = tmp_path / "real.yaml"
    config.write_text(dumped(document))
    start("practice_robot", "--ros-args", "--params-file", practice)  # for this run a robot as any other
    run = start("rkhs", "train", config, "--quiet", "--out", tmp_path / "run")
    probe.add_service("gate/arm", Trigger)
    answer = probe.ask("describe_task", DescribeTask.Request())
    while not answer.waiting:
        assert run.popen.poll() is None
        answer = probe.ask("describe_task", DescribeTask.Request())
    assert "the gate is not armed" in answer.waiting
    probe.settle(1.5)  # for the learner to say so
    assert probe.ask("gate/arm", Trigger.Request()).success
    code, _, err = run.finish()
    assert code == 0, err
    assert "the robot node waits: the gate is not armed; see that the robot may move, then: rkhs robot arm" in err
