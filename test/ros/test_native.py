"""Manually started nodes: arguments, parameter files, parameters, namespaces and sockets."""

import os
import re
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter

from rkhs_ros.base.settings import entries
from rkhs_ros.learning.training_settings import NoModel, Training
from rkhs_ros.nodes.core.transport import PROFILES, RANGE
from test.processes import of_process
from test.ros.conftest import ROOT, Probe, Process

Start = Callable[..., Process]
DISCOVERY_GROUP = "239.255.0.1"  # joined on the loopback interface
TOY = ROOT / "config" / "toy_nac.yaml"


def refusal(process: Process) -> str:
    """Return the one line that a process says when it refuses its arguments."""
    code, out, err = process.finish()
    assert (code, out, err.count("\n")) == (2, "", 1), err
    return err


def test_a_node_refuses_invalid_arguments_in_one_line(start: Start) -> None:
    plain, unreadable = (start("learner", "run.yaml"), start("learner", "--ros-args", "--params-file", "nowhere.yaml"))
    assert "--ros-args --params-file run.yaml" in refusal(plain)
    assert "error: nowhere.yaml: cannot read the parameter file: No such file" in refusal(unreadable)


def test_a_node_without_a_section_exits_with_an_error(start: Start, tmp_path: Path) -> None:
    file = tmp_path / "run.yaml"
    file.write_text(TOY.read_text().replace("/**/", "/b/"))
    process = start("learner", "--ros-args", "--params-file", file, "-r", "__ns:=/a", "-p", "quiet:=true")
    assert f"error: no parameters for /a/learner in {file}" in refusal(process)


def test_nodes_in_a_namespace_share_one_file(start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    arguments = ("--ros-args", "--params-file", TOY, "-r", "__ns:=/a")
    start("simulator", *arguments)
    start("policy", *arguments)
    more = ("-p", "iterations:=3", "-p", "output:=~/run", "-p", "quiet:=true")
    assert start("learner", *arguments, *more).finish() == (0, "", "")
    assert (tmp_path / "run" / "policy.npz").is_file()


def bound(pid: int) -> set[str]:
    """Return the addresses that a process has bound UDP sockets to."""
    links = [os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()]
    inodes = {match[1] for link in links if (match := re.fullmatch(r"socket:\[(\d+)\]", link))}
    rows = [line.split() for line in of_process(pid, "net/udp").splitlines()[1:]]
    packed = {row[1].partition(":")[0] for row in rows if row[9] in inodes and not row[1].endswith(":0000")}
    return {socket.inet_ntoa(bytes.fromhex(address)[::-1]) for address in packed}


def test_a_manually_started_node_uses_the_loopback_interface(
    start: Start, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (RANGE, *PROFILES):
        monkeypatch.delenv(name, raising=False)
    node = start("simulator", "--ros-args", "--params-file", TOY)
    probe.meet("observation")
    assert bound(node.popen.pid) - {DISCOVERY_GROUP} == {"127.0.0.1"}


NAMES = [entry.name for entry in entries(Training(model=NoModel())) if entry.value != ()]  # ROS has no empty lists


def test_every_setting_is_described_and_read_only_with_the_value_of_the_file(
    start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path, probe: Probe
) -> None:
    file = parameters("pendulum_nac", "algorithm.ridge=0.25", "seed=11")
    start("learner", "--ros-args", "--params-file", file, "-p", f"output:={tmp_path / 'out'}")
    kinds = {"describe": DescribeParameters, "get": GetParameters, "set": SetParameters}

    def ask(word: str, **fields: Any) -> Any:
        probe.add_service(f"learner/{word}_parameters", kinds[word])
        return probe.ask(f"learner/{word}_parameters", kinds[word].Request(**fields))

    described = {each.name: each for each in ask("describe", names=NAMES).descriptors}
    assert set(described) == set(NAMES)
    assert all(d.description and d.read_only and d.type != ParameterType.PARAMETER_NOT_SET for d in described.values())
    (discount,) = described["discount"].floating_point_range
    assert (discount.from_value, discount.to_value) == (0.0, 1.0)
    (iterations,) = described["iterations"].integer_range
    assert iterations.from_value == 1
    assert "trajectory" in described["algorithm.critic"].additional_constraints
    assert described["action_repeat"].additional_constraints == "1 to 1000, or one of auto"
    ridge, seed = ask("get", names=["algorithm.ridge", "seed"]).values
    assert (ridge.double_value, seed.integer_value) == (0.25, 11)
    change = Parameter("algorithm.ridge", value=0.5).to_parameter_msg()
    assert not ask("set", parameters=[change]).results[0].successful
