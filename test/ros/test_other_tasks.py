"""A learner accepts only simulators of its task."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

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


@pytest.mark.nightly
def test_a_learner_without_an_environment_uses_that_of_the_simulator(
    start: Start, parameters: Parameters, tmp_path: Path
) -> None:
    file = parameters("toy_nac", "iterations=4", "horizon=60", "timeout=60")
    start("simulator", "--ros-args", "--params-file", file)
    start("policy")
    document = yaml.safe_load(file.read_text())
    del document["/**/learner"]["ros__parameters"]["environment"]
    alone = tmp_path / "learner.yaml"
    alone.write_text(yaml.safe_dump({"learner": document["/**/learner"]}))
    folder = tmp_path / "out"
    more = ("-p", f"output:={folder}", "-p", "quiet:=true")
    learner = start("learner", "--ros-args", "--params-file", alone, *more)
    code, _, err = learner.finish()
    assert (code, err) == (0, "")
    assert "no environment is set: using that of the simulator" in "".join(learner.told)
    assert "id: rkhs/Toy-v0" in (folder / "config.yaml").read_text()
