"""If nodes of a robot are killed or suspended, it comes to rest, and no finished episode is lost or run twice."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from std_srvs.srv import Trigger

from rkhs_interfaces.msg import Command, GateState
from rkhs_ros.nodes.core.messages import LATCHED_QOS, LOCKSTEP_QOS
from rkhs_ros.policies.storage import policy_arrays
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.recording import RecordedBatch, read_recording
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.replay import replay
from test.faults.runs import arrays
from test.faults.test_kills import MOST_KILLS
from test.ros.conftest import Probe, Process, kill, nodes_of, probe
from test.ros.robot_bench import CONFIG, QUICK

__all__ = ["probe"]
Start = Callable[..., Process]
NODES = ("learner", "policy", "robot")
PERIOD, COMMAND_TIMEOUT = 0.02, 1.0
# At five times wall speed a step is the same for the robot; late actions of a busy machine are tolerated.
AT_SPEED = (
    "simulated_robot.speed=5.0",
    f"robot.period={PERIOD}",
    "robot.action_deadline=0.9",
    "robot.misses_allowed=30",
    "robot.stale_after=0.5",
    "robot.learner_timeout=1.0",
    "robot.reset.home.speed=[15.0]",
    f"gate.command_timeout={COMMAND_TIMEOUT}",
    "gate.stale_after=0.5",
    "timeout=60",
)
PLAIN = ("model={form: none}", "algorithm={name: rkhs_nac}")


class Watch:
    """Records the commands and the state of the gate."""

    def __init__(self, node: Node) -> None:
        self.commands: list[Command] = []
        self.states: list[str] = []
        node.create_subscription(Command, "command", self.commands.append, LOCKSTEP_QOS)
        node.create_subscription(GateState, "gate/state", lambda m: self.states.append(m.state), LATCHED_QOS)

    @property
    def is_moving(self) -> bool:
        return self.states[-1:] == ["moving"] and len(self.commands) > 3 and not any(c.hold for c in self.commands[-3:])


def attempts(folder: Path) -> dict[Batch, tuple[bytes, ...]]:
    """Return the time stamps of each finished episode in the recording of a run, by number."""
    if not (folder / "recording.mcap").exists():
        return {}
    return {batch: each.attempt[1] for batch, each in read_recording(folder).by_numbers().items()}


@pytest.mark.timeout(600)
def test_killed_nodes_lose_and_repeat_no_finished_episode(start: Start, tmp_path: Path, probe: Probe) -> None:
    folder, draws, watch = tmp_path / "run", np.random.default_rng(0), Watch(probe)
    size = ("horizon=50", "iterations=8", "episodes_per_iteration=2")
    run = start("rkhs", "train", CONFIG, "--quiet", "--out", folder, "--set", *AT_SPEED, *PLAIN, *size)
    seen: dict[Batch, tuple[bytes, ...]] = {}
    victims = draws.permutation(np.resize(NODES, MOST_KILLS)).tolist()
    done = []
    for name in victims:
        if draws.random() < 0.8:  # during a motion, or else during the recovery from the last kill
            probe.until(lambda: watch.is_moving or run.popen.poll() is not None, 100)
        probe.settle(draws.uniform(0.0, 1.5))
        done += [name for pid in nodes_of(run, name) if kill(pid) is None]
        found = attempts(folder)
        assert seen.items() <= found.items(), "an episode was lost, or run twice"
        seen = found
    run.popen.wait(250.0)
    code, _, err = run.finish()
    recording = read_recording(folder)
    discarded = [each.executions[0].discard_reason for each in recording.batches if each.is_discarded]
    print(f"{len(done)} kills: {', '.join(done)}; {len(discarded)} discarded episodes: {set(discarded)}")
    assert len(done) > len(victims) / 2
    assert (code, "Traceback" in err) == (0, False), err
    config = load_config(folder / "config.yaml")
    assert seen.items() <= attempts(folder).items()
    assert len(recording.by_numbers()) == config.training.iterations * config.training.episodes_per_iteration
    *_, last = replay(recording)
    ours, theirs = policy_arrays(last.policy), arrays(folder)
    for name, values in ours.items():
        np.testing.assert_array_equal(values, theirs[name])


def spoilt(run: Process) -> Iterator[tuple[str, signal.Signals]]:
    """Suspend each node of a run in turn, then kill each; continue after the checks of the test."""
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for name in NODES:
            yield name, number
            for pid in nodes_of(run, name):
                os.kill(pid, signal.SIGCONT)


@pytest.mark.timeout(600)
def test_the_robot_comes_to_rest_whichever_node_is_suspended_or_killed(
    start: Start, tmp_path: Path, probe: Probe
) -> None:
    watch = Watch(probe)
    size = ("iterations=100", "horizon=500")
    run = start("rkhs", "train", CONFIG, "--quiet", "--out", tmp_path / "run", "--set", *AT_SPEED, *PLAIN, *size)
    most = round((COMMAND_TIMEOUT + PERIOD) / PERIOD) + 5
    for name, number in spoilt(run):
        probe.until(lambda: watch.is_moving, 100)
        victims = nodes_of(run, name)
        states, commands = len(watch.states), len(watch.commands)
        for pid in victims:
            os.kill(pid, number)
        probe.until(lambda: bool(set(watch.states[states:]) - {"moving"}), 30)  # noqa: B023  # awaited here
        after = [command.hold for command in watch.commands[commands:]]
        moved = after.index(True) if True in after else len(after)
        assert moved <= most, f"{name} {number.name}: {moved} more commands"
        came_to = next(state for state in watch.states[states:] if state != "moving")
        # The robot node stops the robot before the gate has to; for the robot node itself, the gate reports a fault. If
        # a node is killed, all end.
        ends = {"holding", "stopped"} if number == signal.SIGKILL else {"stopped" if name == "robot" else "holding"}
        assert came_to in ends, f"{name} {number.name}"
    run.interrupt()
    assert run.finish()[0] == 130


def test_a_gate_that_dies_ends_the_run(start: Start, tmp_path: Path, probe: Probe) -> None:
    folder = tmp_path / "run"
    run = start("rkhs", "train", CONFIG, "--quiet", "--out", folder, "--set", *QUICK, "iterations=100")
    probe.until(lambda: bool(probe.heard["episodes"]) or run.popen.poll() is not None, 100)
    for pid in nodes_of(run, "gate"):
        kill(pid)
    code, _, err = run.finish()
    assert code == 1
    assert "error: the gate node was killed by signal 9; without it the robot must not move" in err


def test_a_veto_holds_if_the_run_is_interrupted_and_resumed(start: Start, tmp_path: Path, probe: Probe) -> None:
    folder = tmp_path / "run"
    more = ("iterations=1", "episodes_per_iteration=3", "horizon=300", "robot.misses_allowed=150")
    run = start("rkhs", "train", CONFIG, "--quiet", "--out", folder, "--set", *QUICK, *more)
    probe.add_service("robot/veto", Trigger)
    probe.until(lambda: any(m.first_episode == 1 and m.step > 1 for m in probe.heard["observation"]), 100)
    assert probe.ask_once("robot/veto", Trigger.Request(), "robot").success

    def vetoed() -> list[RecordedBatch]:
        batches = read_recording(folder).batches
        return [each for each in batches if each.executions[0].discard_reason == "vetoed by the operator"]

    probe.until(vetoed, 100)
    run.interrupt()
    run.finish()
    (discarded,) = vetoed()
    recording = read_recording(folder)
    places = [k for k, each in enumerate(recording.batches) if each.attempt == discarded.attempt]
    assert [recording.batches[place].is_discarded for place in places] == [False, True]
    assert places[1] == places[0] + 1  # recorded at once, not at the end of the next episode
    assert discarded.batch not in recording.by_numbers()
    code, _, err = start("rkhs", "train", "--quiet", "--resume", folder).finish()
    assert code == 0, err
    recording = read_recording(folder)
    assert recording.by_numbers()[discarded.batch].attempt != discarded.attempt
    assert len(recording.by_numbers()) == 3
    assert len(list(replay(recording))) == 1
    (row,) = Curve(folder / "curve.csv").rows()
    np.testing.assert_allclose(row.exploration_return, np.mean(recording.episodes().returns(0.99)))
