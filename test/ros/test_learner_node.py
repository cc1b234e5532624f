"""The learner node waits for its peers for a limited time, and names the missing one."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.core.peers import CONNECTION_S
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S
from rkhs_ros.runs.curve import Curve
from test.ros.conftest import Probe, Process

Learner = Callable[..., Process]


class IdlePolicyNode:
    """Refuses some policies at first, then takes all, and never acts."""

    def __init__(self, probe: Probe, refusals: int) -> None:
        self.asked: list[int] = []  # versions
        self._refusals = refusals
        probe.speak("action")
        self._service = probe.create_service(SetPolicy, "set_policy", self._set_policy)

    def _set_policy(self, request: SetPolicy.Request, response: SetPolicy.Response) -> SetPolicy.Response:
        self.asked.append(request.policy.version)
        response.success = len(self.asked) > self._refusals
        response.message = "expected another policy, got this one"
        return response


@pytest.fixture
def learn(start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path) -> Learner:
    """Start a simulator and a learner."""

    def begin(timeout: float) -> Process:
        file = parameters("toy_nac", f"timeout={timeout}")
        start("simulator", "--ros-args", "--params-file", file)
        results = ("-p", f"output:={tmp_path / 'out'}", "-p", "quiet:=true")
        return start("learner", "--ros-args", "--params-file", file, *results)

    return begin


def test_only_a_persistent_refusal_ends_the_run(learn: Learner, probe: Probe) -> None:
    policy = IdlePolicyNode(probe, refusals=10**6)
    learner = learn(timeout=20)
    probe.until(lambda: learner.popen.poll() is not None)
    code, _, err = learner.finish()
    assert (code, err) == (2, "error: the policy node refused: expected another policy, got this one\n")
    assert 5 < len(policy.asked) <= CONNECTION_S / SIGNAL_CHECK_S + 2
    assert len(set(policy.asked)) == 1


def test_a_transient_refusal_does_not_end_the_run_but_a_policy_node_that_does_not_act_does(
    learn: Learner, probe: Probe
) -> None:
    policy = IdlePolicyNode(probe, refusals=3)
    learner = learn(timeout=2)
    probe.until(lambda: learner.popen.poll() is not None)
    code, _, err = learner.finish()
    assert (code, err) == (75, "error: the simulator node did not answer within 2 s\n")  # it has ended before
    assert len(policy.asked) == 4


@pytest.mark.parametrize("interrupted", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_a_manually_started_learner_draws_figures_and_prints_next_steps(
    start: Callable[..., Process], parameters: Callable[..., Path], probe: Probe, tmp_path: Path, interrupted: bool
) -> None:
    folder, iterations = tmp_path / "out", 100_000 if interrupted else 2
    file = ("--params-file", parameters("toy_nac", f"iterations={iterations}"))
    start("simulator", "--ros-args", *file)
    start("policy")
    learner = start("drawing_learner", "--ros-args", *file, "-p", f"output:={folder}", "-p", "quiet:=true")
    if interrupted:
        probe.until(lambda: (folder / "curve.csv").is_file() and len(Curve(folder / "curve.csv").rows()) > 1)
        learner.interrupt()
    code, _, err = learner.finish()
    assert (code, err) == (130 if interrupted else 0, "")
    assert {"curve.png", "policy.png", "policy.npz"} <= {path.name for path in folder.iterdir()}
    said, remedy = learner.told[-1], f"rkhs train --resume {folder}"
    assert (f"resume with: {remedy}" if interrupted else f"continue: {remedy}") in said
    assert ("interrupted after" in said) == interrupted
