"""The page of the nodes lists every topic and service that they offer or use."""

import re
from collections.abc import Callable
from pathlib import Path

from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.runs.config import load_config
from test.ros.conftest import ROOT, Probe, Process
from test.ros.robot_bench import CONFIG, QUICK

ROBOTS = ("simulated_robot", "gate", "robot", "policy", "learner")
OF_EVERY_ROS_NODE = r"/(rosout|parameter_events|\w+/(describe|get|list|set)_\w+|\w+/get_type_description)"


def names(probe: Probe, node: str) -> set[str]:
    """Return the topics and services of a node, but those that every ROS node has."""
    found = (
        *probe.get_service_names_and_types_by_node(node, "/"),
        *probe.get_publisher_names_and_types_by_node(node, "/"),
        *probe.get_subscriber_names_and_types_by_node(node, "/"),
    )
    return {name for name, _ in found if not re.fullmatch(OF_EVERY_ROS_NODE, name)}


def test_the_page_lists_all_topics_and_services(
    start: Callable[..., Process], parameters: Callable[..., Path], probe: Probe, tmp_path: Path
) -> None:
    page = (ROOT / "docs" / "nodes.md").read_text()
    documented = {f"/{name.strip('/')}" for name in re.findall(r"`([\w/]+)`", page)}
    configured = {f"/{name}" for name in re.findall(r"topic: ([\w/]+)", CONFIG.read_text())}
    file = write_parameters(load_config(CONFIG, QUICK), tmp_path / "parameters.yaml", output=str(tmp_path / "run"))
    for name in ROBOTS:
        start(name, "--ros-args", "--params-file", file)
    probe.until(lambda: bool(probe.count_publishers("progress")))
    start("simulator", "--ros-args", "--params-file", parameters("toy_nac"))
    offered = {"simulator": {"/start_episodes", "/observation"}, "robot": {"/robot/veto"}, "gate": {"/gate/arm"}}
    for node, some in offered.items():
        probe.until(lambda node=node, some=some: node in probe.get_node_names() and some <= names(probe, node))
    for node in (*ROBOTS, "simulator"):
        assert names(probe, node) <= documented | configured, node
    assert {"/command", "/action", "/episodes"} <= documented & names(probe, "robot")
