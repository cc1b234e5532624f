"""The learner node waits for its peers for a limited time, and names the missing one."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.core.diagnostics import UNCONNECTED
from test.ros.conftest import Probe, Process

Learner = Callable[..., Process]


class IdlePolicyNode:
    """Refuses policies at first, then takes all, and never acts."""

    def __init__(self, probe: Probe, refusals: int, refusal: str) -> None:
        self.asked: list[int] = []  # versions
        self._refusals, self._refusal = refusals, refusal
        probe.speak("action")
        self._service = probe.create_service(SetPolicy, "set_policy", self._set_policy)

    def _set_policy(self, request: SetPolicy.Request, response: SetPolicy.Response) -> SetPolicy.Response:
        self.asked.append(request.policy.version)
        response.success, response.message = len(self.asked) > self._refusals, self._refusal
        return response


@pytest.fixture
def learn(start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path) -> Learner:

    def begin(timeout: float) -> Process:
        file = parameters("toy_nac", f"timeout={timeout}")
        start("simulator", "--ros-args", "--params-file", file)
        results = ("-p", f"output:={tmp_path / 'out'}", "-p", "quiet:=true")
        return start("learner", "--ros-args", "--params-file", file, *results)

    return begin


@pytest.mark.parametrize(
    ("refusal", "refusals", "end"),
    [
        ("expected another policy", 1, (2, "the policy node refused: expected another policy")),
        (f"{UNCONNECTED}nobody is there", 3, (75, "the simulator node did not answer within 2 s")),  # it has ended
    ],
)
def test_a_refusal_ends_the_run_unless_the_nodes_have_not_met(
    learn: Learner, probe: Probe, refusal: str, refusals: int, end: tuple[int, str]
) -> None:
    policy = IdlePolicyNode(probe, refusals, refusal)
    learner = learn(timeout=2)
    probe.until(lambda: learner.popen.poll() is not None)
    code, _, err = learner.finish()
    assert (code, err) == (end[0], f"error: {end[1]}\n")
    assert len(policy.asked) == max(refusals, 1) + (end[0] == 75)
    assert len(set(policy.asked)) == 1


def test_a_manually_started_learner_draws_figures_and_prints_next_steps(
    start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path
) -> None:
    folder, file = tmp_path / "out", ("--params-file", parameters("toy_nac", "iterations=2"))
    start("simulator", "--ros-args", *file)
    start("policy")
    learner = start("drawing_learner", "--ros-args", *file, "-p", f"output:={folder}", "-p", "quiet:=true")
    code, _, err = learner.finish()
    assert (code, err) == (0, "")
    assert {"curve.png", "policy.png", "policy.npz"} <= {path.name for path in folder.iterdir()}
    assert f"continue: rkhs train --resume {folder}" in learner.told[-1]


def test_a_simulator_of_another_task_is_refused_by_name(
    start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path
) -> None:
    file = parameters("pendulum_nac")
    start("simulator", "--ros-args", "--params-file", file, "-p", "environment.options.angle:=wrap")
    learner = start("learner", "--ros-args", "--params-file", file, "-p", f"output:={tmp_path / 'out'}")
    code, _, err = learner.finish()
    expected = 'expected the environment rkhs/Pendulum-v0 with options {"angle": "clip"}'
    got = 'got rkhs/Pendulum-v0 with options {"angle": "wrap"}'
    assert (code, err) == (1, f"error: the simulator node: {expected}, {got}\n")
    assert not (tmp_path / "out").exists()
