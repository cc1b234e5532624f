"""The names of a run's nodes, and of what they are started with."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Mapping, Sequence
from pathlib import PurePath

from rkhs_ros.base.validation import pick

NODES = ("simulator", "simulated_robot", "gate", "robot", "policy", "learner")


def fresh_number() -> int:
    """Return a number that names a batch or a policy: nobody else uses or can guess it, and no result depends on it."""
    return 1 + secrets.randbelow(2**63 - 1)


def namespaces(simulators: int) -> list[str]:
    """Return the namespaces of that many simulator nodes, relative ones with their slash; none for a single one."""
    return [""] if simulators == 1 else [f"simulator_{k + 1}/" for k in range(simulators)]


def node_names(simulators: int, robot: Collection[str] = ()) -> list[str]:
    """Return the names of all nodes of a run, the learner's last.

    Args:
        simulators: their number.
        robot: names of the nodes that are there in place of a simulator.
    """
    worlds = [name for name in NODES if name in robot]
    worlds = worlds or [f"{namespace}simulator" for namespace in namespaces(simulators)]
    return [*worlds, "policy", "learner"]


def in_one_line(error: Exception) -> str:
    """Return why a topic's name is none; ROS points to the place in further lines."""
    return " ".join(str(error).rstrip(" ^\n").split())


def require_known_arguments(words: Sequence[str], file: str, known: Mapping[str, object]) -> None:
    """Refuse arguments that a launch file does not have, which ``ros2 launch`` passes over in silence.

    Args:
        words: the command line. Where it starts another launch file, that includes this one, all may be meant for it.
        file: name of the launch file.
        known: its arguments.

    Raises:
        ValueError: there is one that it does not have.
    """
    names = [PurePath(word).name for word in words]
    for word in words[names.index(file) + 1 :] if file in names else ():
        name, assigned, _ = word.partition(":=")
        if assigned:
            pick(name, known, "argument")
