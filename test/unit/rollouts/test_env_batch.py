"""Batches of every kind of environment: from ids, objects, copies, single and flattened environments."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Tuple
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import TransformReward

from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.environments import env_batch_of
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import random_policy

Observation = np.ndarray[Any, Any]
FIELDS = ("observations", "actions", "rewards", "mask", "final_observations", "terminated")


class Countdown(gymnasium.Env[Any, Any]):
    """Terminates after an even random number of steps, truncates after an odd one, and counts calls."""

    observation_space: Any = Box(-100.0, 100.0, (2,), np.float32)
    action_space = Box(-1.0, 1.0, (1,), np.float32)
    made: list["Countdown"] = []
    most = 100
    least = 1
    strict = True  # raise unless reset in time

    def __init__(self) -> None:
        if len(self.made) >= self.most:
            raise RuntimeError("there is only one robot")
        self.made.append(self)
        self.steps = 0
        self.going = False

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        if self.going and self.strict:
            raise RuntimeError("reset during an episode")
        self.lasts = self.left = int(self.np_random.integers(self.least, 9))
        self.going = True
        return self.observe(), {}

    def step(self, action: Observation) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        self.left -= 1
        self.going = self.left > 0
        even = self.lasts % 2 == 0
        return self.observe(), float(action[0]), not self.going and even, not self.going and not even, {}

    def observe(self) -> Any:
        return np.array([self.left, self.lasts], dtype=np.float32)


gymnasium.register("test/Countdown-v0", Countdown, max_episode_steps=12)


@pytest.fixture(autouse=True)
def countdown() -> None:
    Countdown.made = []


@pytest.fixture
def policy(rng: np.random.Generator) -> GaussianPolicy:
    return random_policy(rng, d=2, n=1)


BATCH = Batch(3, 0, 10, 12, explore=True)


def test_episodes_store_the_final_observation_and_the_kind_of_end(policy: GaussianPolicy) -> None:
    episodes = InlineRunner(Simulation("test/Countdown-v0")).collect(policy, BATCH)
    lasts = episodes.observations[:, 0, 1].astype(int)
    assert len(set(lasts)) > 3
    assert np.array_equal(episodes.mask.sum(axis=1), lasts)
    assert np.array_equal(episodes.final_observations, np.stack([np.zeros(10), lasts], axis=1))
    assert np.array_equal(episodes.terminated, lasts % 2 == 0)
    for name in ("observations", "actions", "rewards"):
        assert not getattr(episodes, name)[~episodes.mask].any()


def test_finished_environments_are_not_stepped_and_copies_are_created_on_demand(policy: GaussianPolicy) -> None:
    runner = InlineRunner(Simulation("test/Countdown-v0"))
    assert len(Countdown.made) == 1
    episodes = runner.collect(policy, BATCH)
    assert len(Countdown.made) == 10
    assert sum(env.steps for env in Countdown.made) == episodes.mask.sum()
    runner.collect(policy, Batch(3, 10, 4, 12, explore=False))
    assert len(Countdown.made) == 10


def sources() -> dict[str, Callable[[], Any]]:
    modes = {mode.name: lambda mode=mode: SyncVectorEnv([Countdown] * 4, autoreset_mode=mode) for mode in AutoresetMode}
    return {
        "an environment": Countdown,
        "a class": lambda: Countdown,
        "an environment with a time limit": lambda: gymnasium.make("test/Countdown-v0"),
        "a function": lambda: lambda: gymnasium.make("test/Countdown-v0"),
        "a function of a vector environment": lambda: lambda: SyncVectorEnv([Countdown] * 3),
        **modes,
    }


@pytest.mark.parametrize("source", sources())
def test_every_kind_of_environment_gives_the_same_episodes(
    policy: GaussianPolicy, source: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = InlineRunner(Simulation("test/Countdown-v0")).collect(policy, BATCH)
    whole = "vector" in source or source in AutoresetMode.__members__  # which resets environments itself
    monkeypatch.setattr(Countdown, "strict", not whole)
    episodes = InlineRunner(Simulation(sources()[source]())).collect(policy, BATCH)
    for name in FIELDS:
        assert np.array_equal(getattr(episodes, name), getattr(expected, name)), name


@pytest.mark.parametrize("how", ["setting", "metadata", "found out"])
def test_a_single_environment_runs_its_episodes_in_sequence(
    policy: GaussianPolicy, how: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = InlineRunner(Simulation("test/Countdown-v0")).collect(policy, BATCH)
    Countdown.made = []
    monkeypatch.setattr(Countdown, "most", 1)
    if how == "metadata":
        monkeypatch.setattr(Countdown, "metadata", {"num_envs": 1, "render_modes": []})
    simulation = Simulation("test/Countdown-v0", num_envs=1 if how == "setting" else 0)
    episodes = InlineRunner(simulation).collect(policy, BATCH)
    for name in FIELDS:
        assert np.array_equal(getattr(episodes, name), getattr(expected, name)), name
    err = capsys.readouterr().err
    assert err.count("\n") == (how == "found out")
    assert ("test/Countdown-v0: limited to 1 at a time" in err) == (how == "found out")


@pytest.mark.parametrize(("kind", "vector"), [("dict", False), ("tuple", True)])
def test_dictionary_and_tuple_observations_are_flattened(policy: GaussianPolicy, kind: str, vector: bool) -> None:
    class Composed(Countdown):
        observation_space = (
            Dict(left=Box(-100.0, 100.0, (), np.float32), zlasts=Box(-100.0, 100.0, (1,), np.float32))
            if kind == "dict"
            else Tuple([Box(-100.0, 100.0, (1,), np.float32), Box(-100.0, 100.0, (1,), np.float32)])
        )

        def observe(self) -> Any:
            left, lasts = super().observe().reshape(2, 1)
            return {"left": np.float32(left[0]), "zlasts": lasts} if kind == "dict" else (left, lasts)

        strict = False

    expected = InlineRunner(Simulation("test/Countdown-v0")).collect(policy, BATCH)
    source = (lambda: SyncVectorEnv([Composed] * 3)) if vector else Composed
    episodes = InlineRunner(Simulation(source)).collect(policy, BATCH)
    assert np.array_equal(episodes.observations, expected.observations)


def test_an_instance_has_id_and_options_unless_wrapped() -> None:
    made = Simulation(gymnasium.make("MountainCarContinuous-v0", goal_velocity=0.01))
    assert (made.environment, made.options) == ("MountainCarContinuous-v0", {"goal_velocity": 0.01})
    wrapped = gymnasium.wrappers.TransformReward(gymnasium.make("Pendulum-v1"), lambda reward: 2 * reward)
    assert Simulation(wrapped).environment == "PendulumEnv"
    several = {"num_envs": 2, "vectorization_mode": "sync"}
    made = Simulation(gymnasium.make_vec("Pendulum-v1", **several, max_episode_steps=50, g=9.0))
    assert (made.environment, made.options, made.time_limit) == ("Pendulum-v1", {"g": 9.0}, 50)
    doubled = [lambda env: gymnasium.wrappers.TransformReward(env, lambda reward: 2 * reward)]
    for vector in (
        gymnasium.make_vec("Pendulum-v1", **several, wrappers=doubled),
        TransformReward(gymnasium.make_vec("Pendulum-v1", **several), lambda reward: 2 * reward),
    ):
        made = Simulation(vector)
        assert (made.environment, made.options) == ("SyncVectorEnv", {})


def test_the_arrays_of_a_vector_environment_are_copied() -> None:
    class Reused(OldGenerator):
        observation_space = Box(-1.0, 1.0, (2,), np.float64)

    batch = env_batch_of(SyncVectorEnv([Reused] * 2, copy=False))
    first = batch.reset([1, 2], 5)
    observations, _, terminated, _ = batch.step(np.zeros((2, 1)), np.ones(2, dtype=bool))
    known = first.copy(), observations.copy()
    again = batch.reset([3, 4], 5)
    assert not np.array_equal(first, again)
    np.testing.assert_array_equal((first, observations), known)
    assert not np.shares_memory(terminated, batch.shown.unwrapped._terminations)


class OldGenerator(gymnasium.Env[Any, Any]):
    """An environment whose random generator takes seeds of 32 bits."""

    observation_space = Box(-1.0, 1.0, (2,))
    action_space = Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None and seed >= 2**32:
            raise ValueError("Seed must be between 0 and 2**32 - 1")
        self.first = np.random.default_rng(seed).uniform(-1.0, 1.0, 2).astype(np.float32)
        return self.first, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.first, 0.0, False, False, {}


@pytest.mark.parametrize("source", [SyncVectorEnv([Countdown] * 4), lambda: SyncVectorEnv([Countdown] * 4)])
def test_a_vector_environment_runs_at_most_the_given_number(source: Any) -> None:
    assert [env_batch_of(source, None, most).capacity(9) for most in (0, 3, 7)] == [4, 3, 4]


def test_an_environment_with_an_old_generator_gets_32_bits_of_the_seed() -> None:
    envs = env_batch_of(OldGenerator, None, 2)
    assert envs.capacity(2) == 2
    large = 2**40 + 5
    assert np.array_equal(envs.reset([large, 7], 3), envs.reset([5, 7], 3))
