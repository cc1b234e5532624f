"""Model rollouts: a policy that acts in a model of its task, every row in a model drawn from the posterior."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel, points_of
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import DrawnFunctions, Posterior

START_VISITED_EVERY = (
    4  # of how many model rollouts one begins at an observation that was seen in the midst of an episode
)


class ModelRunner:
    """Lets policies act in a model; a `Runner` like a simulation.

    A row draws its functions once and the noise of each step, all from the stream of its episode, and depends on no
    other row: split batches have the same bits.

    Args:
        model: of the task.
        caution: factor on how far the functions drawn stray from their mean.
    """

    def __init__(self, model: DynamicsModel, caution: float = 1.0) -> None:
        self._model = model
        self._caution = caution

    @property
    def spaces(self) -> Spaces:
        """Shape of an observation, and bounds of the actions."""
        return self._model.spaces

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        model = self._model
        streams = [stream(batch.seed, "imagination", episode) for episode in batch.episodes]
        starts = self._starts(batch, streams)
        changes = self._drawn(model.state_delta, streams)
        rewards = None if model.rewards is None else self._drawn(model.rewards, streams)
        shape = (batch.horizon, model.spaces.observation_dim)
        noise = np.stack([own.standard_normal(shape) for own in streams]) * model.state_delta.noise
        observations, actions, points = self._roll_out(policy, batch, starts, changes, noise)
        return self._cut(observations, actions, self._rewards(observations, points, rewards))

    def _starts(self, batch: Batch, streams: list[np.random.Generator]) -> Array:
        """Return where episodes begin: as real ones, every fourth where any step did, so that all is practised.

        Where the past is seen through a window all begin as real ones, before which there is none.
        """
        model = self._model
        places = (model.starts, model.visited if model.inputs.history == 1 else model.starts)
        chosen = [places[episode % START_VISITED_EVERY == 1] for episode in batch.episodes]
        return np.stack([place[own.integers(len(place))] for place, own in zip(chosen, streams, strict=True)])

    def _drawn(self, posterior: Posterior, streams: list[np.random.Generator]) -> DrawnFunctions:
        shape = posterior.coefficients.mean.T.shape
        return posterior.draw(self._caution * np.stack([own.standard_normal(shape) for own in streams]))

    def _roll_out(
        self, policy: GaussianPolicy, batch: Batch, starts: Array, changes: DrawnFunctions, noise: Array
    ) -> tuple[Array, Array, Array]:
        """Return observations, shape (rows, H + 1, d), actions and points, shape (rows, H, .), whatever may end."""
        model, inputs = self._model, policy.inputs
        acting = Acting(policy, batch, explore=batch.explore)
        rows, horizon, n = batch.num_envs, batch.horizon, policy.mean.output_dim
        observations = np.empty((rows, horizon + 1, starts.shape[1]))
        actions, points = np.zeros((rows, horizon, n)), np.empty((rows, horizon, model.state_delta.points.dimension))
        observations[:, 0] = starts
        for step in range(horizon):
            now = observations[:, step]
            actions[:, step] = acting(step, now)
            if inputs.history == 1:
                seen = inputs.features(now)
            else:
                seen = inputs.at(np.array([step]), observations[:, : step + 1], actions[:, : step + 1])[:, 0]
            points[:, step] = points_of(seen, actions[:, step], model.spaces)
            unknown = changes(points[:, step]) + noise[:, step]
            observations[:, step + 1] = model.predict(now, points[:, step, -n:], unknown)
        return observations, actions, points

    def _rewards(self, observations: Array, points: Array, drawn: DrawnFunctions | None) -> Array:
        """Return the rewards of all steps, shape (rows, H): as known, or drawn, and then within the range seen."""
        known, n = self._model.priors.reward_fn, self.spaces.action_dim
        if known is not None:
            steps = (observations[:, :-1], points[..., -n:], observations[:, 1:])
            return known(*(each.reshape(-1, each.shape[-1]) for each in steps)).reshape(points.shape[:2]).copy()
        if drawn is None:
            raise ValueError("model: expected rewards that are known or learnt, got neither")
        if self._model.reward_depends_on_next:
            points = np.concatenate([self._model.inputs.features(observations[:, 1:]), points[..., -n:]], axis=-1)
        rewards = np.stack([drawn.of_draw(row, its_points)[:, 0] for row, its_points in enumerate(points)])
        return np.clip(rewards, *self._model.reward_range)

    def _ended(self, observations: Array) -> NDArray[np.bool_]:
        """Return whether the task ends an episode with each of the observations, shape (rows, H, d): (rows, H)."""
        known, ends = self._model.priors.termination_fn, self._model.termination
        if known is not None:
            ended = known(observations.reshape(-1, observations.shape[-1])) != 0.0
            return np.asarray(ended).reshape(observations.shape[:2])
        if ends is None:
            return np.zeros(observations.shape[:2], dtype=bool)
        expected = ends.draw(np.zeros((1, *ends.coefficients.mean.T.shape)))
        features = self._model.inputs.features(
            self._model.clip_to_observed(observations)
        )  # beyond the end it is the end, too
        return np.stack([expected.of_draw(0, its_features)[:, 0] > 0 for its_features in features])

    def _cut(self, observations: Array, actions: Array, rewards: Array) -> Episodes:
        """Return the episodes, each up to where the model ends it."""
        before, after = observations[:, :-1], observations[:, 1:]
        rows, horizon = rewards.shape
        ended = self._ended(after)
        terminated = np.asarray(ended.any(axis=1))
        last = np.where(terminated, ended.argmax(axis=1), horizon - 1)
        mask = np.arange(horizon) <= last[:, None]
        each = np.arange(rows)
        rewards[each[terminated], last[terminated]] += self._model.last_reward
        going = mask[:, :, None]
        return Episodes(
            observations=np.where(going, before, 0.0),
            actions=np.where(going, actions, 0.0),
            rewards=np.where(mask, rewards, 0.0),
            mask=mask,
            final_observations=after[each, last],
            terminated=terminated,
        )
