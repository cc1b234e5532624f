"""Names of the components of observations, actions and policy inputs."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

from rkhs_ros.policies.inputs import Inputs

UNIT = re.compile(r"\s*\([^()]*\)$")


@dataclass(frozen=True)
class Names:
    """Names of a task's observation and action components, with units.

    Attributes:
        observations: name of each component of an observation.
        actions: name of each component of an action.
    """

    observations: tuple[str, ...]
    actions: tuple[str, ...]


def default_names(kind: str, count: int) -> tuple[str, ...]:
    """Return default names such as "observation 0"."""
    return tuple(f"{kind} {i}" if count > 1 else kind for i in range(count))


def reported_names(names: object, count: int) -> tuple[str, ...]:
    """Return the names that user code reports if they are ``count`` strings, else an empty tuple."""
    good = isinstance(names, list | tuple) and len(names) == count and all(isinstance(name, str) for name in names)
    return tuple(names) if good else ()  # type: ignore[arg-type]


def input_names(inputs: Inputs, names: Names, action_repeat: int = 1) -> tuple[str, ...]:
    """Return the names of the policy's inputs in their order.

    Args:
        inputs: the inputs.
        names: names of a task's components.
        action_repeat: number of steps per decision; the entries of a history are one decision apart.
    """
    observed = _with_angles(names.observations, inputs.columns)
    if inputs.history > 1:
        ages = range((inputs.history - 1) * action_repeat, -1, -action_repeat)
        earlier = ((_with_age(observed, ago), _with_age(names.actions, ago + action_repeat)) for ago in ages)
        observed = [name for both in earlier for part in both for name in part]
    if inputs.degree == 0:
        return tuple(observed)
    chosen = combinations_with_replacement(range(len(observed) + 1), inputs.degree)
    return tuple(" · ".join(observed[i] for i in columns if i < len(observed)) or "constant" for columns in chosen)


def _with_angles(observations: Sequence[str], angles: Sequence[int]) -> list[str]:
    turned = [UNIT.sub("", observations[column]) for column in angles]
    rest = [name for column, name in enumerate(observations) if column not in angles]
    return [f"{function} of {name}" for function in ("sine", "cosine") for name in turned] + rest


def _with_age(names: Sequence[str], ago: int) -> list[str]:
    return [f"{name}, {ago} step{'s' * (ago > 1)} ago" for name in names] if ago else list(names)
