"""How the nodes of a run reach each other: by UDP, since shared memory does not survive a node that is killed.

A node killed while it holds a lock in shared memory can leave its peers deaf, and what it used is never freed.
For messages as small as ours shared memory is not faster.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rkhs_ros.base.validation import require

FAST_DDS = "rmw_fastrtps_cpp"  # the middleware that ROS 2 comes with
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
REACH = (RANGE, "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "FASTDDS_BUILTIN_TRANSPORTS")  # say how far nodes reach
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")  # older name, and newer
DOMAIN, LAST_DOMAIN = "ROS_DOMAIN_ID", 232  # with the next one UDP has no ports left
LOOPBACK = Path(__file__).with_name("loopback.xml")


def check_domain(environment: Mapping[str, str]) -> None:
    """Raise ValueError where an environment names a domain that is none, of which ROS makes a traceback."""
    domain = environment.get(DOMAIN, "0") or "0"
    good = domain.isascii() and domain.isdigit() and int(domain) <= LAST_DOMAIN
    require(good, DOMAIN, f"a whole number from 0 to {LAST_DOMAIN}", repr(domain))


def by_udp(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment for nodes that are to use UDP only, on this machine unless told otherwise.

    ROS confines nodes to this machine by settings of its own, shared memory among them. They are replaced by a profile
    that confines them as well.

    Args:
        environment: that of this process; what it says of how far nodes reach, and of how Fast DDS is to be set, stays.

    Raises:
        ValueError: it names no domain.
    """
    check_domain(environment)
    if environment.get("RMW_IMPLEMENTATION", FAST_DDS) != FAST_DDS or any(environment.get(name) for name in PROFILES):
        return dict(environment)
    told = next((environment[name] for name in REACH if environment.get(name)), "LOCALHOST")
    if told == "LOCALHOST":
        return {**environment, RANGE: "SUBNET", PROFILES[0]: str(LOOPBACK)}
    return {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **environment}
