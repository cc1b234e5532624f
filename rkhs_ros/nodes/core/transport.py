"""Names of the nodes of a run, and the transport between them: UDP, as shared memory does not survive a killed node.

A node that is killed while it holds a lock in shared memory can block its peers, and its memory is never freed. For
small messages like ours, shared memory is not faster.
"""

import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from rkhs_ros.base.validation import require

NODES = ("simulator", "simulated_robot", "gate", "robot", "policy", "learner")
FAST_DDS = "rmw_fastrtps_cpp"  # the default middleware of ROS 2
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
REACH = (RANGE, "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "FASTDDS_BUILTIN_TRANSPORTS")  # set the discovery range
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")  # older and newer name
DOMAIN, LAST_DOMAIN = "ROS_DOMAIN_ID", 232  # the ports of the next domain exceed the range of UDP
LOOPBACK = Path(__file__).with_name("loopback.xml")


def node_names(robot: Collection[str] = ()) -> list[str]:
    """Return the names of all nodes of a run, the learner last; `robot` names those that replace the simulator."""
    return [*([name for name in NODES if name in robot] or ["simulator"]), "policy", "learner"]


def by_udp(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment for nodes that use UDP only, on this machine unless the given environment says otherwise.

    ROS's own settings for one machine include shared memory. This function replaces them with a profile that confines
    nodes to this machine without shared memory. Raises ValueError for an invalid domain.
    """
    domain = environment.get(DOMAIN, "0") or "0"  # ROS would print a traceback for an invalid one
    good = domain.isascii() and domain.isdigit() and int(domain) <= LAST_DOMAIN
    require(good, DOMAIN, f"a whole number from 0 to {LAST_DOMAIN}", repr(domain))
    if environment.get("RMW_IMPLEMENTATION", FAST_DDS) != FAST_DDS or any(environment.get(name) for name in PROFILES):
        return dict(environment)
    reach = next((environment[name] for name in REACH if environment.get(name)), "LOCALHOST")
    if reach == "LOCALHOST":
        return {**environment, RANGE: "SUBNET", PROFILES[0]: str(LOOPBACK)}
    return {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **environment}


@contextmanager
def using_udp() -> Iterator[None]:
    """Create the nodes of this context with the transport of `by_udp`, and restore the environment afterwards."""
    before = dict(os.environ)
    os.environ.update(by_udp(before))
    try:
        yield
    finally:
        for name in set(os.environ) - set(before):
            del os.environ[name]
        os.environ.update(before)
