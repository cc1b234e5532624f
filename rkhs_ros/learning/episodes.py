"""Episodes as plain arrays, execution logs of episodes on a robot, and the callback that records both."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class Episodes:
    """N episodes of up to H steps.

    Attributes:
        observations: raw observations before each action, shape (N, H, d); `with_inputs` replaces them by the policy's
            inputs for the algorithms.
        actions: sampled actions before clipping, shape (N, H, n).
        rewards: reward of each action, shape (N, H); 0 after the end of an episode.
        mask: True for the steps of an episode, False after its end, shape (N, H).
        final_observations: raw observations after the last step of each episode, shape (N, d).
        terminated: whether the task terminated the episode, False if it was truncated, shape (N,).
    """

    observations: Array
    actions: Array
    rewards: Array
    mask: NDArray[np.bool_]
    final_observations: Array
    terminated: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Raise ValueError if the shapes do not match."""
        shape = self.rewards.shape
        for name in ("observations", "actions", "mask"):
            got = getattr(self, name).shape[:2]
            require(got == shape, f"episodes' {name}", f"{shape} episodes and steps", got)
        for name in ("final_observations", "terminated"):
            got = len(getattr(self, name))
            require(got == shape[0], f"episodes' {name}", f"{shape[0]} episodes", got)

    @classmethod
    def without_ends(cls, observations: Array, actions: Array, rewards: Array, mask: NDArray[np.bool_]) -> Episodes:
        """Return episodes without known final observations: truncated, with the last observation repeated."""
        last = np.maximum(mask.sum(axis=1) - 1, 0)
        final = observations[np.arange(len(mask)), last]
        return cls(observations, actions, rewards, mask, final, np.zeros(len(mask), dtype=bool))

    @classmethod
    def none(cls, horizon: int, observation_dim: int, action_dim: int) -> Episodes:
        """Return an empty set of episodes, to which others can be added."""
        shape = (0, horizon)
        return cls(
            observations=np.zeros((*shape, observation_dim)),
            actions=np.zeros((*shape, action_dim)),
            rewards=np.zeros(shape),
            mask=np.zeros(shape, dtype=bool),
            final_observations=np.zeros((0, observation_dim)),
            terminated=np.zeros(0, dtype=bool),
        )

    def __len__(self) -> int:
        """Return the number of episodes N."""
        return len(self.rewards)

    @classmethod
    def concatenate(cls, parts: Iterable[Episodes]) -> Episodes:
        """Concatenate episodes in order with a single copy; a single part is returned unchanged.

        Raises:
            ValueError: there are no parts, or their horizons or dimensions differ.
        """
        joined = list(parts)
        require(bool(joined), "episodes", "at least one part to join", "none")
        if len(joined) == 1:
            return joined[0]
        return cls(*(np.concatenate([getattr(part, f.name) for part in joined]) for f in fields(cls)))

    def __add__(self, other: Episodes) -> Episodes:
        """Concatenate two sets of episodes, without a copy if one is empty."""
        return Episodes.concatenate([self, other]) if len(self) and len(other) else self if len(self) else other

    def take(self, indices: NDArray[np.int_] | slice) -> Episodes:
        """Return a subset of the episodes."""
        return Episodes(*(getattr(self, f.name)[indices] for f in fields(self)))

    def with_inputs(self, inputs: Inputs) -> Episodes:
        """Return the episodes with the policy's inputs instead of the raw observations."""
        return replace(self, observations=inputs.unfold(self.observations, self.actions))

    def decisions(self, action_repeat: int, discount: float, spaces: Spaces) -> Episodes:
        r"""Return the episodes with one step per decision of a policy that holds each action for N steps.

        .. math:: R_k = \sum_{i<N} \gamma^i r_{kN+i}

        so that the return with the discount :math:`\gamma^N` per decision is the return with gamma per step. If the
        actions of a decision differ, because another policy took them, their clipped mean replaces them. A truncated
        episode ends with its last whole decision, except if it is shorter than one.

        Args:
            action_repeat: N.
            discount: gamma.
            spaces: spaces of the task.
        """
        if action_repeat == 1:
            return self
        repeat, count = action_repeat, -(-self.horizon // action_repeat)
        lengths = self.mask.sum(axis=1)
        whole = np.where(self.terminated | (lengths < repeat), lengths, lengths // repeat * repeat)
        mask = np.arange(self.horizon) < whole[:, None]
        pad = count * repeat - self.horizon

        def grouped(values: NDArray[Any]) -> NDArray[Any]:
            padded = np.pad(values, [(0, 0), (0, pad), *[(0, 0)] * (values.ndim - 2)])
            return padded.reshape(len(values), count, repeat, *values.shape[2:])

        steps, actions = grouped(mask), grouped(self.actions)
        held = ((actions == actions[:, :, :1]).all(axis=3) | ~steps).all(axis=2)[:, :, None]
        clipped = np.where(steps[..., None], spaces.clip(actions), 0.0).sum(axis=2)
        mean = clipped / np.maximum(steps.sum(axis=2), 1)[:, :, None]
        rows, cut = np.arange(len(self)), whole < lengths
        final = self.final_observations.copy()
        final[cut] = self.observations[rows[cut], whole[cut]]
        return Episodes(
            observations=self.observations[:, ::repeat],
            actions=np.where(held, actions[:, :, 0], mean),
            rewards=np.where(steps, grouped(self.rewards), 0.0) @ discount ** np.arange(repeat),
            mask=steps[:, :, 0],
            final_observations=final,
            terminated=self.terminated,
        )

    def held(self, action_repeat: int, horizon: int) -> Episodes:
        """Return the episodes of decisions with N steps per decision, the reward at its first one.

        The observations between two decisions are unknown and repeat the earlier one.

        Args:
            action_repeat: N.
            horizon: number of steps H of the result, at most N per decision.
        """
        if action_repeat == 1:
            return self

        def repeated(values: NDArray[Any]) -> NDArray[Any]:
            return np.repeat(values, action_repeat, axis=1)[:, :horizon]

        mask, first = repeated(self.mask), np.arange(horizon) % action_repeat == 0
        return replace(
            self,
            observations=repeated(self.observations),
            actions=repeated(self.actions),
            rewards=np.where(first, repeated(self.rewards), 0.0),
            mask=mask,
        )

    @property
    def horizon(self) -> int:
        """Maximum number of steps H."""
        return int(self.rewards.shape[1])

    @property
    def count(self) -> int:
        """Number of steps of all episodes."""
        return int(self.mask.sum())

    def returns(self, discount: float) -> Array:
        r"""Return the discounted return :math:`R(\xi) = \sum_t \gamma^t r_t` of each episode, shape (N,)."""
        return np.asarray(self.rewards @ discount ** np.arange(self.horizon))

    def rewards_to_go(self, discount: float) -> Array:
        r"""Return :math:`\sum_{k \ge t} \gamma^{k-t} r_k` at each step, shape (N, H)."""
        return _sums_to_go(self.rewards, discount)

    def lambda_returns(self, value: Array, discount: float, trace: float) -> Array:
        r"""Return the lambda returns of a value function at each step, shape (N, H).

        .. math:: V_t + \sum_{k \ge t} (\gamma \lambda)^{k-t} (r_k + \gamma V_{k+1} - V_k)

        Args:
            value: V at each step, shape (N, H), 0 after the end.
            discount: gamma.
            trace: lambda; for lambda = 1, V cancels and the result is the rewards to go.
        """
        following = np.concatenate([value[:, 1:], np.zeros((len(value), 1))], axis=1)
        return value + _sums_to_go(self.rewards + discount * following - value, discount * trace)

    def flat(self, values: Array) -> Array:
        """Return the entries of an array of shape (N, H, ...) at the steps of the episodes, shape (samples, ...)."""
        return values[self.mask]

    @property
    def ends(self) -> NDArray[np.bool_]:
        """Whether the task terminated the episode at each step, shape (N, H)."""
        ends = np.zeros(self.mask.shape, dtype=bool)
        ends[np.arange(len(self)), self.mask.sum(axis=1) - 1] = self.terminated
        return ends

    @property
    def next_observations(self) -> Array:
        """Raw observations after each step, shape (N, H, d); undefined after the end of an episode."""
        following = np.roll(self.observations, -1, axis=1)
        following[np.arange(len(self)), self.mask.sum(axis=1) - 1] = self.final_observations
        return following

    @property
    def steps(self) -> NDArray[np.int_]:
        """Step t of each sample, shape (samples,)."""
        return np.broadcast_to(np.arange(self.horizon), self.mask.shape)[self.mask]

    @property
    def begins(self) -> NDArray[np.int_]:
        """Index of the first sample of each episode, shape (N,)."""
        lengths = self.mask.sum(axis=1)
        return np.asarray(np.cumsum(lengths) - lengths)


def _sums_to_go(values: Array, factor: float) -> Array:
    """Return the discounted sums from each step to the end."""
    result = np.empty_like(values)
    following = np.zeros(len(values))
    for t in reversed(range(values.shape[1])):
        following = values[:, t] + factor * following
        result[:, t] = following
    return result


@dataclass(frozen=True, eq=False)
class Execution:
    """The execution log of one episode of k steps on a robot.

    Attributes:
        stamps: wall-clock time of each observation, in nanoseconds since 1970, shape (k + 1,).
        executed: commands after all limits, in the units of the robot's commands, shape (k, m).
        flags: bit flags of the gate's changes and late messages at each step, shape (k,).
        discard_reason: why the episode is discarded; empty if learning uses it.
    """

    stamps: NDArray[np.int64]
    executed: Array
    flags: NDArray[np.uint32]
    discard_reason: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError if the shapes do not match."""
        steps = len(self.flags)
        require(
            len(self.stamps) == steps + 1, "execution's stamps", f"{steps + 1}, one more than steps", len(self.stamps)
        )
        require(len(self.executed) == steps, "executed commands", f"{steps}, one per step", len(self.executed))


Record = Callable[[Batch, Episodes, list[Execution]], None]


def discard(batch: Batch, episodes: Episodes, executions: list[Execution]) -> None:
    """Discard finished episodes; the default callback of runners.

    Args:
        batch: the batch with the episodes' numbers.
        episodes: finished episodes, including discarded ones.
        executions: execution log of each episode; empty for simulations.
    """
