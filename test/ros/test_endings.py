"""Signals, silent or dead peers, and bad input: processes exit with one line and leave nothing behind."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_ros.runs.curve import Curve
from test.processes import children_of, is_running
from test.ros.conftest import ROOT, Probe, Process, nodes_of

Start = Callable[..., Process]
Parameters = Callable[..., Path]


@pytest.mark.parametrize("name", ["simulator", "learner"])
def test_a_node_ends_cleanly_on_two_quick_interrupts(
    start: Start, parameters: Parameters, tmp_path: Path, probe: Probe, name: str
) -> None:
    file = parameters("toy_nac")
    arguments = {
        "simulator": ("--params-file", file),
        "learner": ("--params-file", file, "-p", f"output:={tmp_path / 'out'}"),
    }
    process = start(name, "--ros-args", *arguments[name])
    probe.until(lambda: name in probe.get_node_names())
    for _ in range(2):
        process.interrupt()
        time.sleep(0.01)
    code, _, err = process.finish()
    assert (code, err) == (130 if name == "learner" else 0, "")


@pytest.fixture
def run(start: Start, tmp_path: Path, probe: Probe) -> Process:
    """A long run over topics, under way."""
    arguments = ("--quiet", "--iterations", 10_000, "--out", tmp_path / "out", "--set", "timeout=15")
    process = start("rkhs", "train", ROOT / "config" / "toy_nac.yaml", *arguments)
    probe.until(lambda: len(probe.heard["episodes"]) >= 5)
    return process


def test_an_interrupted_run_saves_its_policy_and_leaves_no_process(run: Process, tmp_path: Path) -> None:
    nodes = children_of(run.popen.pid)
    assert len(nodes) == 3
    run.popen.send_signal(signal.SIGTERM)
    code, out, err = run.finish()
    folder = tmp_path / "out"
    assert (code, out) == (130, "")
    saved = f"of 10000 iterations; saved: {folder}/curve.csv, {folder}/policy.npz"
    assert err.splitlines()[-1].endswith(f"{saved}; resume with: rkhs train --resume {folder}")
    assert "Traceback" not in err
    assert not any(map(is_running, nodes))
    assert {"config.yaml", "curve.csv", "policy.npz", "curve.png", "policy.png"} <= set(os.listdir(tmp_path / "out"))


def test_a_run_interrupted_before_its_first_iteration_can_be_resumed(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    run = start("rkhs", "train", ROOT / "config" / "toy_nac.yaml", "--quiet", "--iterations", 2, "--out", folder)
    while not nodes_of(run, "learner"):
        time.sleep(0.001)
    run.popen.send_signal(signal.SIGTERM)
    code, out, err = run.finish()
    assert (code, out) == (130, "")
    assert err.startswith("interrupted after 0 of 2 iterations; saved: ")
    assert err.count("\n") == 1
    code, _, err = start("rkhs", "train", "--quiet", "--resume", folder).finish()
    assert (code, err) == (0, "")
    assert len(Curve(folder / "curve.csv").rows()) == 2


@pytest.mark.ci
def test_a_run_resumes_after_a_node_has_stalled(start: Start, tmp_path: Path, probe: Probe) -> None:
    arguments = ("--quiet", "--iterations", 10_000, "--out", tmp_path / "out", "--set", "timeout=5")
    run = start("rkhs", "train", ROOT / "config" / "toy_nac.yaml", *arguments)
    probe.until(lambda: len(probe.heard["episodes"]) >= 5)
    nodes = children_of(run.popen.pid)
    (victim,) = nodes_of(run, "policy")
    os.kill(victim, signal.SIGSTOP)
    probe.until(lambda: not any(map(is_running, nodes)))
    count = len(probe.heard["episodes"])
    probe.until(lambda: len(probe.heard["episodes"]) > count)
    run.interrupt()
    code, _, err = run.finish()
    assert code == 130
    errors = [line for line in err.splitlines() if line.startswith("error:")]
    assert errors[0] in (f"error: the policy node did not {how} within 5 s" for how in ("act", "answer"))
    assert len(errors) == err.count("warning: the run resumes after iteration ") == 1


def test_an_invalid_parameter_ends_a_node_with_one_line(start: Start, domain: int) -> None:
    code, _, err = start("learner", "--ros-args", "-p", "algorithm.rigde:=0.1").finish()
    assert (code, err) == (2, "error: unknown key 'algorithm.rigde', did you mean 'algorithm.ridge'?\n")
