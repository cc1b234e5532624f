"""Convert episodes to messages and back; each message is checked before use."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.policies.messages import doubles, shaped
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch


def episodes_message(
    types: Any, identity: int, version: int, episodes: Episodes, executions: Sequence[Execution] = ()
) -> Any:
    """Convert the episodes of a batch to a message.

    Args:
        types: object with the message types as attributes: Episodes and Execution.
        identity: number of the batch.
        version: version of the policy that acted.
        episodes: episodes of the batch.
        executions: execution log of each episode; empty for simulations.
    """
    num_envs, horizon = episodes.rewards.shape
    return types.Episodes(
        batch=identity,
        policy_version=version,
        num_envs=num_envs,
        horizon=horizon,
        lengths=_packed("I", episodes.mask.sum(axis=1), np.uint32),
        terminated=episodes.terminated.tolist(),
        observations=doubles(episodes.observations),
        final_observations=doubles(episodes.final_observations),
        actions=doubles(episodes.actions),
        rewards=doubles(episodes.rewards),
        executions=[_execution_message(types, execution) for execution in executions],
    )


def _execution_message(types: Any, execution: Execution) -> Any:
    return types.Execution(
        stamps=_packed("q", execution.stamps, np.int64),
        executed=doubles(execution.executed),
        flags=_packed("I", execution.flags, np.uint32),
        discard_reason=execution.discard_reason,
    )


def _packed(code: str, values: NDArray[Any], kind: type) -> array[int]:
    return array(code, np.ascontiguousarray(values, dtype=kind).tobytes())


def episodes_of(message: Any, batch: Batch, spaces: Spaces) -> Episodes:
    """Read episodes from a message; discarded episodes may have no step.

    Raises:
        ValueError: the size differs from the batch, or a value is not finite.
    """
    shape = (batch.num_envs, batch.horizon)
    require(
        (message.num_envs, message.horizon) == shape, "episodes", f"{shape}", f"{(message.num_envs, message.horizon)}"
    )
    for name in ("lengths", "terminated"):
        size = len(getattr(message, name))
        require(size == batch.num_envs, f"episodes' {name}", f"{batch.num_envs} entries", size)
    lengths = np.array(message.lengths, dtype=np.int64)
    least = 0 if any(execution.discard_reason for execution in message.executions) else 1
    good = bool(((lengths >= least) & (lengths <= batch.horizon)).all())
    require(good, "episodes' lengths", f"{least} to {batch.horizon} steps", lengths)
    return Episodes(
        observations=shaped(message.observations, (*shape, spaces.observation_dim), "episodes' observations"),
        actions=shaped(message.actions, (*shape, spaces.action_dim), "episodes' actions"),
        rewards=shaped(message.rewards, shape, "episodes' rewards"),
        mask=np.arange(batch.horizon) < lengths[:, None],
        final_observations=shaped(
            message.final_observations, (batch.num_envs, spaces.observation_dim), "episodes' final observations"
        ),
        terminated=np.array(message.terminated, dtype=bool),
    )


def executions_of(message: Any) -> list[Execution]:
    """Read the execution logs of a robot's episodes from a message; empty for simulations.

    Raises:
        ValueError: the sizes do not match, or a command is not finite.
    """
    return [_execution_of(execution) for execution in message.executions]


def _execution_of(message: Any) -> Execution:
    steps, size = len(message.flags), len(message.executed)
    columns = size // steps if steps else 0
    return Execution(
        stamps=np.array(message.stamps, dtype=np.int64),
        executed=shaped(message.executed, (steps, columns), "executed commands"),
        flags=np.array(message.flags, dtype=np.uint32),
        discard_reason=message.discard_reason,
    )
