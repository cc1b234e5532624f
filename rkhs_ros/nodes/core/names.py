"""Names of a run's nodes, and validation of launch arguments."""

import secrets
from collections.abc import Collection, Mapping, Sequence
from pathlib import PurePath

from rkhs_ros.base.validation import pick

NODES = ("simulator", "simulated_robot", "gate", "robot", "policy", "learner")


def fresh_number() -> int:
    """Return a random identifier of a batch or a policy, unique among all clients; no result depends on it."""
    return 1 + secrets.randbelow(2**63 - 1)


def node_names(robot: Collection[str] = ()) -> list[str]:
    """Return the names of all nodes of a run; the learner is the last.

    Args:
        robot: names of the nodes that replace the simulator.
    """
    return [*([name for name in NODES if name in robot] or ["simulator"]), "policy", "learner"]


def in_one_line(error: Exception) -> str:
    """Return the message of an invalid name in one line; ROS adds lines that mark the position."""
    return " ".join(str(error).rstrip(" ^\n").split())


def require_known_arguments(words: Sequence[str], file: str, known: Mapping[str, object]) -> None:
    """Refuse unknown arguments of a launch file, which ``ros2 launch`` ignores.

    Args:
        words: the command line. If it starts another launch file that includes this one, nothing is refused.
        file: name of the launch file.
        known: its arguments.

    Raises:
        ValueError: an argument is unknown.
    """
    names = [PurePath(word).name for word in words]
    for word in words[names.index(file) + 1 :] if file in names else ():
        name, assigned, _ = word.partition(":=")
        if assigned:
            pick(name, known, "argument")
