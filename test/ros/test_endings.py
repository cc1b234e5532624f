"""Signals, silent or dead peers, and bad input: every process ends, says why in one line, and leaves nothing behind."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from test.ros.conftest import PATIENCE, ROOT, Probe, Process

Start = Callable[..., Process]
Parameters = Callable[..., Path]


@pytest.mark.parametrize("signals", [1, 2])
@pytest.mark.parametrize("name", ["simulator", "policy", "learner"])
def test_a_node_ends_cleanly_on_one_and_on_two_quick_interrupts(
    start: Start, parameters: Parameters, tmp_path: Path, probe: Probe, name: str, signals: int
) -> None:
    file = parameters("toy_nac")
    arguments = {
        "simulator": ("--params-file", file),
        "policy": (),
        "learner": ("--params-file", file, "-p", f"output:={tmp_path / 'out'}"),
    }
    process = start(name, "--ros-args", *arguments[name])
    probe.until(lambda: name in probe.get_node_names())
    for _ in range(signals):
        process.interrupt()
        time.sleep(0.01)
    code, _, err = process.finish()
    assert (code, err) == (0, "")


def children(process: Process) -> list[int]:
    return [
        int(pid) for pid in Path(f"/proc/{process.popen.pid}/task/{process.popen.pid}/children").read_text().split()
    ]


def alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture
def run(start: Start, tmp_path: Path, probe: Probe) -> Process:
    """A long run over topics, under way."""
    arguments = (
        "--quiet",
        "--iterations",
        10_000,
        "--out",
        tmp_path / "out",
        "--set",
        "timeout=5",
    )  # long enough to start
    process = start("rkhs", "train", ROOT / "config" / "toy_nac.yaml", *arguments)
    probe.until(lambda: len(probe.heard["episodes"]) >= 5)
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_keeps_what_it_learnt_and_leaves_no_process(
    run: Process, tmp_path: Path, number: signal.Signals
) -> None:
    nodes = children(run)
    assert len(nodes) == 3
    run.popen.send_signal(number)
    _, _, err = run.finish()
    assert "Traceback" not in err
    assert not any(map(alive, nodes))
    assert {"config.yaml", "curve.csv", "policy.npz", "curve.png", "policy.png"} <= set(os.listdir(tmp_path / "out"))


@pytest.mark.parametrize("name", ["simulator", "policy"])
def test_a_node_that_stalls_ends_the_run_by_name(run: Process, name: str) -> None:
    nodes = children(run)
    (victim,) = [p for p in nodes if f"{name}_node" in Path(f"/proc/{p}/cmdline").read_text()]
    os.kill(victim, signal.SIGSTOP)
    code, _, err = run.finish()
    assert code == 1
    (line,) = [line for line in err.splitlines() if line.startswith("error:")]
    assert f"the {name} node" in line
    assert "Traceback" not in err
    assert not any(map(alive, nodes))


def test_a_learner_alone_names_who_is_missing(start: Start, parameters: Parameters, tmp_path: Path) -> None:
    out = f"output:={tmp_path / 'out'}"
    file = parameters("toy_nac", "timeout=1")
    code, _, err = start("learner", "--ros-args", "--params-file", file, "-p", out).finish()
    assert (code, err) == (1, "error: the simulator node did not answer within 1 s\n")
    start("simulator", "--ros-args", "--params-file", file)
    code, _, err = start(
        "learner", "--ros-args", "--params-file", parameters("toy_nac", "timeout=4"), "-p", out
    ).finish()
    assert (code, err) == (1, "error: the policy node did not answer within 4 s\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["simulator", "policy", "learner"])
def test_a_second_node_of_a_name_ends_and_the_first_goes_on(
    start: Start, parameters: Parameters, probe: Probe, tmp_path: Path, name: str
) -> None:
    file = parameters("toy_nac", "iterations=10000")
    arguments = {
        "simulator": ("--params-file", file),
        "policy": (),
        "learner": ("--params-file", file, "-p", f"output:={tmp_path / 'out'}"),
    }
    for each, given in arguments.items():
        start(each, "--ros-args", *given)
    probe.until(lambda: len(probe.heard["episodes"]) >= 2)
    arguments["learner"] = ("--params-file", file, "-p", f"output:={tmp_path / 'other'}")
    code, _, err = start(name, "--ros-args", *arguments[name]).finish()
    assert code == 1
    (line,) = [line for line in err.splitlines() if line.startswith("error:")]
    assert line.startswith(f"error: expected one {name} node, got another that was there before")
    count = len(probe.heard["episodes"])
    probe.until(lambda: len(probe.heard["episodes"]) >= count + 5)


def test_two_runs_at_once_on_the_same_names_leave_the_first_one_its_bits(start: Start, tmp_path: Path) -> None:
    def begin(out: str, config: str, *more: object) -> Process:
        return start("rkhs", "train", ROOT / "config" / config, "--quiet", "--out", tmp_path / out, *more)

    def curve(out: str) -> list[str]:
        file = tmp_path / out / "curve.csv"
        return [line.rpartition(",")[0] for line in file.read_text().splitlines()] if file.exists() else []

    first = begin("first", "toy_nac.yaml", "--iterations", 100_000)
    assert begin("alone", "toy_nac.yaml", "--iterations", 200, "--runner", "inline").finish()[0] == 0
    assert begin("second", "pendulum_nac.yaml").finish()[0] == 1
    while len(curve("first")) < 202:
        assert first.popen.poll() is None
        time.sleep(0.1)
    first.interrupt()
    first.finish()
    assert curve("first")[:201] == curve("alone")


@pytest.mark.parametrize(
    ("name", "assignment", "reason"),
    [
        ("learner", "algorithm.rigde:=0.1", "unknown key 'algorithm.rigde', did you mean 'ridge'?"),
        ("learner", "discount:=1.5", "discount: expected a number in [0.0, 1.0], got 1.5"),
        ("learner", "algorithm.name:=nca", "unknown algorithm.name 'nca'"),
        ("simulator", "environment.id:=rkhs/Pendulm-v0", "did you mean 'rkhs/Pendulum-v0'?"),
        ("simulator", "environment.id:=CartPole-v1", "CartPole-v1 actions: expected a continuous space"),
        ("simulator", "enviroment:=1", "unknown key 'enviroment'"),
        ("policy", "policy_file:=nowhere.npz", "nowhere.npz"),
        ("policy", "policy_fil:=x", "did you mean 'policy_file'?"),
    ],
)
def test_bad_parameters_end_a_node_with_one_line(
    start: Start, domain: int, name: str, assignment: str, reason: str
) -> None:
    begin = time.monotonic()
    code, _, err = start(name, "--ros-args", "-p", assignment).finish()
    assert code == 2
    assert err.startswith("error: ")
    assert reason in err
    assert err.count("\n") == 1
    assert time.monotonic() - begin < PATIENCE
