"""Foreign nodes in the domain: results stay bit-identical, or the run ends and names the node."""

import os
import re
import signal
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from rkhs_interfaces.msg import Action, Observation
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS
from test.faults.runs import assert_same_bits
from test.ros.conftest import ROOT, Probe, Process

pytestmark = pytest.mark.nightly

Start = Callable[..., Process]
Parameters = Callable[..., Path]
SHORT = ("iterations=4", "horizon=60", "timeout=60")


@pytest.fixture(scope="module")
def in_process(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run in process."""
    folder = tmp_path_factory.mktemp("runs") / "in_process"
    arguments = ("--quiet", "--runner", "inline", "--out", folder, "--set", *SHORT)
    assert Process("rkhs", "train", ROOT / "config" / "toy_nac.yaml", *arguments).finish()[0] == 0
    return folder


class Nodes:
    """Simulator and policy node, which the probe has met before the learner comes."""

    def __init__(
        self, start: Start, parameters: Parameters, probe: Probe, folder: Path, *policy_arguments: str
    ) -> None:
        self._start, self._folder = start, folder
        self._file = parameters("toy_nac", *SHORT)
        self.simulator = start("simulator", "--ros-args", "--params-file", self._file)
        self._policy_arguments = policy_arguments
        self.policy = self.start_policy()
        probe.meet("episodes")
        probe.until(lambda: {"simulator", "policy"} <= set(probe.get_node_names()))

    def start_policy(self) -> Process:
        return self._start("policy", "--ros-args", *self._policy_arguments)

    def learn(self) -> Process:
        results = ("-p", f"output:={self._folder}", "-p", "quiet:=true")
        return self._start("learner", "--ros-args", "--params-file", self._file, *results)


@pytest.fixture
def nodes(start: Start, parameters: Parameters, probe: Probe, tmp_path: Path) -> Nodes:
    return Nodes(start, parameters, probe, tmp_path / "out")


def finish(learner: Process, probe: Probe) -> tuple[int, str]:
    probe.until(lambda: learner.popen.poll() is not None, 60.0)
    code, out, err = learner.finish()
    assert (out, "Traceback" in err) == ("", False)
    return code, err


def once_at_step(probe: Probe, step: int, act: Callable[[], None]) -> Observation:
    """Do something when that step is first heard; return the observation last heard thereafter."""
    met: list[int] = []

    def hear(message: Observation) -> None:
        if message.step == step and not met:
            met.append(step)
            act()

    probe.create_subscription(Observation, "observation", hear, LOCKSTEP_QOS)
    probe.until(lambda: met != [])
    probe.settle()
    return probe.heard["observation"][-1]


def test_a_forged_action_is_detected_and_its_batch_restarted(
    nodes: Nodes, probe: Probe, tmp_path: Path, in_process: Path
) -> None:
    probe.say("action", Action())  # the simulator has met it
    learner = nodes.learn()
    asked = once_at_step(probe, 5, lambda: os.kill(nodes.policy.popen.pid, signal.SIGSTOP))  # so that it is not faster
    forged = Action(batch=asked.batch, step=asked.step, policy_version=asked.policy_version)
    forged.actions = array("d", np.full(asked.num_envs, 0.75))
    probe.say("action", forged)
    probe.until(lambda: probe.heard["observation"][-1].step > asked.step)
    os.kill(nodes.policy.popen.pid, signal.SIGCONT)
    code, err = finish(learner, probe)
    assert code == 0, err
    refused = (
        rf"refused episodes: simulator: environment 0 \(episode {asked.first_episode}\), step {asked.step}: expected"
    )
    assert re.search(refused + r" the policy's action \[.+\], got \[0.75\]", err), err
    assert "/action: /policy, /probe (unknown); /episodes: /simulator" in err
    assert_same_bits(tmp_path / "out", in_process)


def test_a_second_publisher_is_named(nodes: Nodes, probe: Probe) -> None:
    states: dict[str, set[tuple[bytes, str]]] = {"/simulator": set(), "/policy": set()}

    def hear(message: DiagnosticArray) -> None:
        for status in message.status:
            states[status.name].add((status.level, status.message))

    probe.create_subscription(DiagnosticArray, "/diagnostics", hear, DIAGNOSTICS_QOS)
    probe.until(lambda: all(states.values()))
    assert {level for heard in states.values() for level, _ in heard} == {DiagnosticStatus.OK}
    probe.say("action", Action())
    probe.say("observation", Observation())
    warnings = {
        "/simulator": "more than one publisher: /action: /policy, /probe (unknown)",
        "/policy": "more than one publisher: /observation: /probe (unknown), /simulator",
    }
    for name, text in warnings.items():
        probe.until(lambda: (DiagnosticStatus.WARN, text) in states[name])  # noqa: B023  # awaited here
    for process, name in ((nodes.simulator, "/simulator"), (nodes.policy, "/policy")):
        process.interrupt()
        assert warnings[name].replace("more than one publisher:", "expected one publisher, got") in process.finish()[2]


@pytest.mark.nightly
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


@pytest.mark.nightly
def test_a_resumed_run_refuses_another_task_and_is_unchanged(
    start: Start, parameters: Parameters, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    file = ROOT / "config" / "pendulum_nac.yaml"
    small = ("iterations=3", "horizon=10")
    run = start("rkhs", "train", file, "--quiet", "--runner", "inline", "--out", folder, "--set", *small)
    assert run.finish()[0] == 0
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    other = parameters("pendulum_nac", *small, "iterations=4", "environment.options.angle=wrap")
    start("simulator", "--ros-args", "--params-file", other)
    start("policy")
    go_on = ("-p", f"output:={folder}", "-p", "resume:=true", "-p", "quiet:=true")
    code, _, err = start("learner", "--ros-args", "--params-file", other, *go_on).finish()
    assert code == 2
    assert "environment.options.angle: expected clip as at the start of the run, got wrap" in err
    assert err.count("\n") == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_a_learner_without_an_environment_uses_the_simulators(
    start: Start, parameters: Parameters, tmp_path: Path
) -> None:
    file = parameters("toy_nac", *SHORT)
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
    assert "no environment is set: using that of the first simulator" in "".join(learner.told)
    assert "id: rkhs/Toy-v0" in (folder / "config.yaml").read_text()
