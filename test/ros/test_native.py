"""Manually started nodes: arguments, parameter files, namespaces and sockets."""

import os
import re
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

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
    plain, unreadable = (
        start("learner", "run.yaml"),
        start("learner", "--ros-args", "--params-file", "nowhere.yaml"),
    )
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
