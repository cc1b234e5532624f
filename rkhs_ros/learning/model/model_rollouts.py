"""Model rollouts: a policy acts in the learnt model, each episode in functions drawn from the posterior."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.termination import Limits
from rkhs_ros.learning.model.transitions import points_of
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import DrawnFunctions, Posterior

START_VISITED_EVERY = 4  # one of this many rollouts starts at a visited observation instead of an initial one
REWARD_MARGIN = 0.3  # in training, so that a policy looks for more than was observed


@dataclass(frozen=True)
class Draws:
    """The random functions and noise of model rollouts.

    Attributes:
        changes: functions of the changes of the observations, one draw per episode.
        rewards: functions of the rewards, one draw per episode; None with a prior.
        noise: noise of the changes in the observations' units, shape (N, H, d).
        limits: lower and upper limits of the features, shape (N, 2, q); None if the model has no limits.
    """

    changes: DrawnFunctions
    rewards: DrawnFunctions | None
    noise: Array
    limits: Array | None


Functions = tuple[DrawnFunctions, DrawnFunctions | None]


class ModelRunner:
    """A `Runner` that rolls out policies in a model instead of a simulation.

    Each episode draws its start, the noise of its steps and, unless they share worlds, its functions from its own
    random stream. Episodes do not depend on each other, so splitting a batch gives bit-identical results.

    The model knows little far from the data, and its limits there are walls that the task does not have. From the step
    on at which a rollout reaches them, it earns the least observed reward, so that policies do not exploit them, unless
    optimism asks for what is unknown.

    Args:
        model: model of the task.
        optimism: additional reward of a step per relative standard deviation of the changes that the model predicts,
            so that the policy explores states that were not visited yet.
        visited_starts: let a quarter of the rollouts start from visited observations.
        worlds: a random stream for each world, that is, functions that rollouts share, which take turns; without any,
            each rollout draws its own functions.
        reward_margin: by which rewards may lie outside the observed range, relative to its width.
    """

    def __init__(
        self,
        model: DynamicsModel,
        *,
        optimism: float = 0.0,
        visited_starts: bool = True,
        worlds: Sequence[np.random.Generator] = (),
        reward_margin: float = REWARD_MARGIN,
    ) -> None:
        self._model = model
        self._reward_margin = reward_margin
        self._optimism = optimism
        self._visited_starts = visited_starts
        self._worlds = self._functions(list(worlds)) if worlds else None

    @property
    def spaces(self) -> Spaces:
        """Shape of an observation and bounds of the actions."""
        return self._model.spaces

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Run the episodes of a batch with the policy."""
        streams = [stream(batch.seed, "imagination", episode) for episode in batch.episodes]
        starts = self._starts(batch, streams)
        draws = self.draw(streams, batch.horizon, self._shared(batch))
        observations, actions, points = self._roll_out(policy, batch, starts, draws)
        return self._judged(observations, actions, points, draws, self._beyond(observations))

    def draw(self, streams: list[np.random.Generator], horizon: int, functions: Functions | None = None) -> Draws:
        """Draw the functions, unless they are given, and the noise of one episode from each random stream."""
        changes, rewards = functions or self._functions(streams)
        shape, ends = (horizon, self.spaces.observation_dim), self._model.termination
        noise = np.stack([own.standard_normal(shape) for own in streams]) * self._model.state_delta.noise
        limits = np.stack([ends.draw(own) for own in streams]) if isinstance(ends, Limits) else None
        return Draws(changes, rewards, noise, limits)

    def _shared(self, batch: Batch) -> Functions | None:
        """Return the functions of the episodes' worlds, which take turns; None if each episode draws its own."""
        if self._worlds is None:
            return None
        changes, rewards = self._worlds
        turns = np.array(batch.episodes) % len(changes.weights)
        return changes.take(turns), None if rewards is None else rewards.take(turns)

    def _functions(self, streams: list[np.random.Generator]) -> Functions:
        changes, rewards = self._model.state_delta, self._model.rewards
        return self._drawn(changes, streams), None if rewards is None else self._drawn(rewards.posterior, streams)

    def step(self, draws: Draws, path: Array, inputs: Array, actions: Array) -> Episodes:
        """Advance each rollout by one step; return these steps as N episodes of one step.

        Args:
            draws: draws of the rollouts.
            path: observations of the rollouts so far, shape (N, t + 1, d).
            inputs: inputs of the policy, shape (N, q).
            actions: actions, clipped to their bounds here, shape (N, n).
        """
        points, after = self._advance(draws, draws.noise[:, path.shape[1] - 1], inputs, path[:, -1], actions)
        path = np.concatenate([path, after[:, None]], axis=1)
        return self._judged(path[:, -2:], actions[:, None], points[:, None], draws, self._beyond(path)[:, -1:])

    def _starts(self, batch: Batch, streams: list[np.random.Generator]) -> Array:
        """Return the first observations of the episodes.

        With visited starts, a quarter of the rollouts start from visited observations, so that the rollouts cover all
        states. If the inputs have a history, all rollouts start from initial observations, because these have no past.
        """
        visited = self._model.visited
        anywhere = self._visited_starts and self._model.inputs.history == 1
        is_visited = [anywhere and episode % START_VISITED_EVERY == 1 for episode in batch.episodes]
        return np.stack(
            [
                visited[own.integers(len(visited))] if this else self._model.draw_start(own)
                for this, own in zip(is_visited, streams, strict=True)
            ]
        )

    def _drawn(self, posterior: Posterior, streams: list[np.random.Generator]) -> DrawnFunctions:
        normals = np.stack([own.standard_normal(posterior.draw_shape) for own in streams])
        return posterior.draw(normals)

    def _roll_out(
        self, policy: GaussianPolicy, batch: Batch, starts: Array, draws: Draws
    ) -> tuple[Array, Array, Array]:
        """Run the rollouts to the horizon, even if they terminate earlier."""
        acting = Acting(policy, batch, explore=batch.explore)
        rows, horizon, n = batch.num_envs, batch.horizon, policy.mean.output_dim
        observations = np.empty((rows, horizon + 1, starts.shape[1]))
        actions, points = np.zeros((rows, horizon, n)), np.empty((rows, horizon, policy.mean.input_dim + n))
        observations[:, 0] = starts
        for step in range(horizon):
            now = observations[:, step]
            actions[:, step] = acting(step, now)
            points[:, step], observations[:, step + 1] = self._advance(
                draws, draws.noise[:, step], acting.points, now, actions[:, step]
            )
        return observations, actions, points

    def _advance(self, draws: Draws, noise: Array, inputs: Array, now: Array, actions: Array) -> tuple[Array, Array]:
        """Return the inputs of the model, shape (N, p), and the next observations, shape (N, d)."""
        model = self._model
        points = points_of(inputs, actions, model.spaces)
        return points, model.predict(now, points[:, -actions.shape[1] :], draws.changes(points) + noise)

    def _judged(
        self, observations: Array, actions: Array, points: Array, draws: Draws, beyond: NDArray[np.bool_]
    ) -> Episodes:
        """Return the episodes of rollouts with their rewards, each of which ends where the model terminates it."""
        ended = self._ended(observations[:, 1:], draws.limits)
        terminated = np.asarray(ended.any(axis=1))
        last = np.where(terminated, ended.argmax(axis=1), ended.shape[1] - 1)
        earned = self._rewards(observations, points, draws.rewards, last)
        if self._optimism > 0.0:
            earned += self._optimism * self._novelty(points)
        else:
            earned = np.where(beyond, self._model.least_rewards(points[..., -self.spaces.action_dim :]), earned)
        return self._cut(observations, actions, earned, terminated, last)

    def _beyond(self, observations: Array) -> NDArray[np.bool_]:
        """Return whether rollouts have, by the end of each step, reached a limit at which they did not start."""
        at_limits = self._model.at_limits(observations)
        return np.logical_or.accumulate((at_limits[:, 1:] & ~at_limits[:, :1]).any(axis=2), axis=1)

    def _rewards(
        self, observations: Array, points: Array, drawn: DrawnFunctions | None, last: NDArray[np.int_]
    ) -> Array:
        """Return the rewards of all steps, shape (N, H): from the prior, or drawn and clipped.

        A prior may be undefined after the ``last`` steps of the rollouts, which are repeated for it, shape (N,).
        """
        learnt, actions = self._model.rewards, points[..., -self.spaces.action_dim :]
        if learnt is None or drawn is None:
            rows, steps = np.arange(len(last))[:, None], np.minimum(np.arange(points.shape[1]), last[:, None])
            parts = (observations[rows, steps], actions[rows, steps], observations[rows, steps + 1])
            known = self._model.known_rewards(*(each.reshape(-1, each.shape[-1]) for each in parts))
            return known.reshape(points.shape[:2])
        if learnt.depends_on_next:
            points = np.concatenate([self._model.inputs.features(observations[:, 1:]), actions], axis=-1)
        return learnt.of(drawn.along(points)[:, :, 0], actions, self._reward_margin)

    def _novelty(self, points: Array) -> Array:
        """Return the model's standard deviation of the changes, relative to their spread, shape (N, H)."""
        changes = self._model.state_delta
        relative = changes.sd(points.reshape(-1, points.shape[-1])) / changes.targets.scale
        return np.asarray(relative.mean(axis=1).reshape(points.shape[:2]))

    def _ended(self, observations: Array, limits: Array | None) -> NDArray[np.bool_]:
        """Return whether each observation, shape (N, H, d), terminates its episode: shape (N, H)."""
        model, shape = self._model, observations.shape[:2]
        if model.priors.termination_fn is not None:
            ended = model.priors.termination_fn(observations.reshape(-1, observations.shape[-1])) != 0.0
            return np.asarray(ended).reshape(shape)
        if limits is not None:
            features = model.inputs.features(observations)
            return np.asarray(((features < limits[:, :1]) | (features > limits[:, 1:])).any(axis=2))
        if not isinstance(model.termination, Posterior):
            return np.zeros(shape, dtype=bool)
        # Clipping extends the boundary of termination beyond the observed range.
        features = model.inputs.features(model.clip_to_observed(observations))
        return np.asarray(model.termination.expected().along(features)[:, :, 0] > 0)

    def _cut(
        self, observations: Array, actions: Array, rewards: Array, terminated: NDArray[np.bool_], last: NDArray[np.int_]
    ) -> Episodes:
        """Return the episodes, each of which ends with its ``last`` step."""
        before, after = observations[:, :-1], observations[:, 1:]
        rows, horizon = rewards.shape
        mask = np.arange(horizon) <= last[:, None]
        each = np.arange(rows)
        ends = each[terminated], last[terminated]
        if self._model.rewards is not None:
            points = points_of(self._model.inputs.features(after[ends]), actions[ends], self.spaces)
            rewards[ends] = self._model.rewards.terminal.add(rewards[ends], points)
        going = mask[:, :, None]
        return Episodes(
            observations=np.where(going, before, 0.0),
            actions=np.where(going, actions, 0.0),
            rewards=np.where(mask, rewards, 0.0),
            mask=mask,
            final_observations=after[each, last],
            terminated=terminated,
        )
