"""A learner accepts only simulators of its task."""

from collections.abc import Callable
from pathlib import Path

from test.ros.conftest import Process

Start = Callable[..., Process]
Parameters = Callable[..., Path]


def test_a_simulator_of_another_task_is_refused_by_name(start: Start, parameters: Parameters, tmp_path: Path) -> None:
    file = parameters("pendulum_nac")
    start("simulator", "--ros-args", "--params-file", file, "-p", "environment.options.angle:=wrap")
    learner = start("learner", "--ros-args", "--params-file", file, "-p", f"output:={tmp_path / 'out'}")
    code, _, err = learner.finish()
    expected = 'expected the environment rkhs/Pendulum-v0 with options {"angle": "clip"}'
    got = 'got rkhs/Pendulum-v0 with options {"angle": "wrap"}'
    assert (code, err) == (1, f"error: the simulator node: {expected}, {got}\n")
    assert not (tmp_path / "out").exists()
