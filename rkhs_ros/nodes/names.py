"""The names of a run's nodes."""

from __future__ import annotations

import secrets

NODES = ("simulator", "policy", "learner")


def fresh_number() -> int:
    """Return a number that names a batch or a policy: nobody else uses or can guess it, and no result depends on it."""
    return 1 + secrets.randbelow(2**63 - 1)


def namespaces(simulators: int) -> list[str]:
    """Return the namespaces of that many simulator nodes, relative ones with their slash; none for a single one."""
    return [""] if simulators == 1 else [f"simulator_{k + 1}/" for k in range(simulators)]


def node_names(simulators: int) -> list[str]:
    """Return the names of all nodes of a run, the learner's last."""
    return [*(f"{namespace}simulator" for namespace in namespaces(simulators)), "policy", "learner"]
