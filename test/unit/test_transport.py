"""Nodes of a run talk by UDP, and only as far as they were allowed to."""

import pytest

from rkhs_ros.nodes.transport import LOOPBACK, PROFILES, RANGE, by_udp


@pytest.mark.parametrize("given", [{}, {RANGE: "LOCALHOST"}, {RANGE: "", PROFILES[0]: ""}])
def test_nodes_keep_to_this_machine_unless_told_otherwise(given: dict[str, str]) -> None:
    environment = {**given, "HOME": "/home"}
    assert by_udp(environment) == {RANGE: "SUBNET", PROFILES[0]: str(LOOPBACK), "HOME": "/home"}
    assert environment == {**given, "HOME": "/home"}
    assert "<address>127.0.0.1</address>" in LOOPBACK.read_text()


@pytest.mark.parametrize("given", [{RANGE: "SUBNET"}, {RANGE: "OFF"}, {"ROS_STATIC_PEERS": "192.168.0.7"}])
def test_nodes_of_several_machines_find_each_other(given: dict[str, str]) -> None:
    assert by_udp(given) == {**given, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}


@pytest.mark.parametrize(
    "given",
    [
        {RANGE: "LOCALHOST", PROFILES[0]: "mine.xml"},
        {PROFILES[1]: "mine.xml"},
        {RANGE: "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
        {RANGE: "SUBNET", "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"},
        {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"},
    ],
)
def test_what_was_chosen_otherwise_stays(given: dict[str, str]) -> None:
    assert by_udp(given) == given
