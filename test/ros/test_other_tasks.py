"""A learner accepts only simulators of its task."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from test.ros.conftest import Process

pytestmark = pytest.mark.nightly

Start = Callable[..., Process]
Parameters = Callable[..., Path]


@pytest.mark.parametrize(
    "changes", [{"environment.id": "rkhs/PendulumPOMDP-v0"}, {"environment.options.angle": "wrap"}]
)
def test_a_simulator_of_another_task_is_refused_by_name(
    start: Start, parameters: Parameters, tmp_path: Path, changes: dict[str, str]
) -> None:
    file = parameters("pendulum_nac")
    given = [word for name, value in changes.items() for word in ("-p", f"{name}:={value}")]
    start("simulator", "--ros-args", "--params-file", file, *given)
    start("policy")
    learner = start("learner", "--ros-args", "--params-file", file, "-p", f"output:={tmp_path / 'out'}")
    environment = changes.get("environment.id", "rkhs/Pendulum-v0")
    angle = changes.get("environment.options.angle", "clip")
    code, _, err = learner.finish()
    assert (code, err) == (
        1,
        'error: the simulator node: expected the environment rkhs/Pendulum-v0 with options {"angle": "clip"}, '
        f'got {environment} with options {{"angle": "{angle}"}}\n',
    )
    assert not (tmp_path / "out").exists()


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
