"""The nodes of a run communicate by UDP, within the configured range."""

import pytest

from rkhs_ros.nodes.core.transport import LOOPBACK, PROFILES, RANGE, by_udp


@pytest.mark.parametrize("given", [{}, {RANGE: "LOCALHOST"}, {RANGE: "", PROFILES[0]: ""}])
def test_nodes_use_this_machine_by_default(given: dict[str, str]) -> None:
    environment = {**given, "HOME": "/home"}
    assert by_udp(environment) == {RANGE: "SUBNET", PROFILES[0]: str(LOOPBACK), "HOME": "/home"}
    assert environment == {**given, "HOME": "/home"}
    assert "<address>127.0.0.1</address>" in LOOPBACK.read_text()


@pytest.mark.parametrize("given", [{RANGE: "SUBNET"}, {RANGE: "OFF"}, {"ROS_STATIC_PEERS": "192.168.0.7"}])
def test_nodes_of_several_machines_discover_each_other(given: dict[str, str]) -> None:
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
def test_existing_transport_settings_are_preserved(given: dict[str, str]) -> None:
    assert by_udp(given) == given


@pytest.mark.parametrize("domain", ["abc", "-1", "233", "\u0663"])
def test_an_invalid_domain_is_refused(domain: str) -> None:
    with pytest.raises(ValueError, match="ROS_DOMAIN_ID: expected a whole number from 0 to 232, got"):
        by_udp({"ROS_DOMAIN_ID": domain})
