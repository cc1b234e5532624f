"""Validation in the model keeps the best policy, and training goes on as long as it improves."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from hypothesis import given, strategies as st

from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model_based.validation import Validation, recommended
from rkhs_ros.learning.state import first_policy
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import ModelBased, Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch, stream, stream_seed
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import model_free

HORIZON = 12
PENDULUM = "rkhs/Pendulum-v0"
SMALL = ModelBased(updates=40, rollouts=7, centres=30, discovery="none")
TRAINING = model_free(
    iterations=2,
    episodes_per_iteration=2,
    evaluation_episodes=1,
    horizon=HORIZON,
    exploration_sd="range",
    algorithm=RKHSNAC(centres=12),
    model=SMALL,
)


def constant(action: float, dimension: int = 2) -> GaussianPolicy:
    mean = Function(RBF((1e4,)), np.zeros((1, dimension)), np.array([[action]]))
    return GaussianPolicy(mean, ConstantVariance(np.ones(1)))


class Scripted(ModelRunner):
    """A runner whose first episode earns the weight of the policy's mean, each other one ``spread`` more."""

    def __init__(self) -> None:
        self.batches: list[Batch] = []
        self.spread = 1.0

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        self.batches.append(batch)
        shape = (batch.num_envs, batch.horizon)
        rewards = np.zeros(shape)
        rewards[:, 0] = policy.mean.weights[0, 0] + self.spread * np.arange(batch.num_envs)
        nothing = np.zeros((*shape, 1))
        return Episodes.without_ends(nothing, nothing, rewards, np.ones(shape, dtype=bool))


@given(values=st.lists(st.integers(-5, 5), min_size=1, max_size=12))
def test_validation_keeps_the_first_of_the_best_policies(values: list[int]) -> None:
    runner = Scripted()
    validation, policies = Validation(3, runner, 7, HORIZON, 0.9), [constant(value + 0.5) for value in values]
    for number, policy in enumerate(policies):
        validation.consider(policy)
        best = int(np.argmax(values[: number + 1]))
        assert validation.best is not None
        assert validation.best.policy is policies[best]
        assert validation.best.mean == pytest.approx(values[best] + 1.5)  # 0, 1 and 2 more
        assert validation.improves == (number - best < 6)
    assert runner.batches == [Batch(7, 0, 3, HORIZON, explore=False)] * len(values)


@pytest.mark.parametrize(("gain", "is_better"), [(-3.0, False), (0.9, False), (1.1, True)])
def test_a_new_policy_replaces_earlier_ones_if_it_gains_more_than_the_standard_error(
    gain: float, is_better: bool
) -> None:
    runner = Scripted()
    validation, first = Validation(5, runner, 7, HORIZON, 1.0), constant(1.0)
    for earlier in (constant(0.5), first, constant(0.9)):
        validation.consider_earlier(earlier)
    assert validation.best is not None
    assert validation.best.policy is first
    runner.spread = 1.0 + np.sqrt(2.0)  # differences with a standard deviation of 2, and a standard error of 1
    second = constant(1.0 + gain - 2.0 * np.sqrt(2.0))
    validation.consider(second)
    assert validation.best.policy is (second if is_better else first)


def test_a_policy_that_was_not_trained_is_not_considered() -> None:
    runner = Scripted()
    validation = Validation(3, runner, 7, HORIZON, 0.9)
    validation.consider_earlier(first_policy(model_free(), Simulation(PENDULUM).spaces))
    assert (validation.best, validation.improves, runner.batches) == (None, True, [])


def learn(training: Training, state: Any = None, task: Any = PENDULUM) -> list[Iteration]:
    return list(train(training, InlineRunner(Simulation(task)), state))


class Push(gymnasium.Env[Any, Any]):
    """Two random numbers that nothing changes; the reward of a step is its action."""

    observation_space = Box(-9.0, 9.0, (2,), np.float64)
    action_space = Box(-2.0, 2.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.now = self.np_random.standard_normal(2)
        return self.now, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.now, float(action[0]), False, False, {}


def fitted(training: Training, episodes: Episodes) -> ModelRunner:
    assert isinstance(training.model, ModelBased)
    policy = first_policy(training, Simulation(PENDULUM).spaces)
    model = DynamicsModel.fit(episodes, policy.inputs, Simulation(PENDULUM).spaces, training.model.centres)
    assert model.starts_vary == (len(episodes) == 1)  # a single start does not show that others equal it
    worlds = [stream(training.seed, f"world {world}", 0) for world in range(5 if model.starts_vary else 1)]
    return ModelRunner(model, visited_starts=model.starts_vary, worlds=worlds)


@pytest.mark.parametrize("episodes", [1, 2])
def test_the_model_return_is_that_of_the_policy_in_rollouts_with_their_own_functions(episodes: int) -> None:
    (iteration,) = learn(replace(TRAINING, iterations=1, episodes_per_iteration=episodes))
    model = fitted(TRAINING, iteration.exploration)._model
    runner = ModelRunner(model, visited_starts=False, reward_margin=0.0)
    seed = stream_seed(TRAINING.seed, "recommendation", 0)
    rollouts = runner.collect(iteration.policy, Batch(seed, 0, SMALL.rollouts, HORIZON, explore=False))
    assert iteration.model_return == rollouts.returns(TRAINING.discount).mean()


@pytest.mark.parametrize(
    ("earned", "best"),
    [
        ([[], []], 1),
        ([[4.0], []], 1),
        ([[4.2], []], 0),
        ([[4.5, 4.5], []], 0),
        ([[4.5], [0.0]], 0),
        ([[4.0], [4.0]], 1),
    ],
)
def test_the_recommended_policy_has_the_greatest_mean_of_its_real_returns_and_that_in_the_model(
    earned: list[list[float]], best: int
) -> None:
    policies = constant(2.0), constant(2.55)  # mean returns of 3 and 3.55
    tried = [(policy, np.array(its)) for policy, its in zip(policies, earned, strict=True)]
    found = recommended(tried, Scripted(), Batch(7, 0, 3, HORIZON, explore=False), 0.9)
    assert found.policy is policies[best]
    assert found.mean == pytest.approx((3.0, 3.55)[best])


def constant_updates(action: Callable[[int], float]) -> tuple[RKHSNAC, list[int]]:
    """Return an algorithm whose updates replace the mean by a constant action, and the list of its updates."""
    updates: list[int] = []

    @dataclass(frozen=True)
    class Constant(RKHSNAC):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            updates.append(experience.iteration)
            update = super().update(policy, experience)
            return update._replace(policy=replace(policy, mean=constant(action(experience.iteration)).mean))

    return Constant(centres=12), updates


def test_training_goes_on_from_an_earlier_policy_that_nothing_new_replaces() -> None:
    starts: list[GaussianPolicy] = []

    @dataclass(frozen=True)
    class Improving(RKHSNAC):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            starts.append(policy)
            action = float(policy.mean(experience.episodes.flat(experience.episodes.observations)).mean())
            update = super().update(policy, experience)
            return update._replace(policy=replace(policy, mean=constant(action + 0.1 if action > 1.0 else 0.0).mean))

    good, _ = constant_updates(lambda number: 1.5)
    wide = replace(TRAINING, kernel=replace(TRAINING.kernel, bandwidth=(1e4,)), iterations=1)
    (first,) = learn(replace(wide, algorithm=good), task=Push)
    (second,) = learn(replace(wide, iterations=2, algorithm=Improving(centres=12)), first.state, task=Push)
    assert not starts[0].mean.weights.any()
    again = next(start for start in starts if np.array_equal(start.mean.weights, first.policy.mean.weights))
    narrow = again.variance(np.zeros((1, 2))) / starts[0].variance(np.zeros((1, 2)))
    np.testing.assert_allclose(narrow, 0.3**2)
    assert second.policy.mean.weights[0, 0] > 1.8


def test_an_earlier_policy_replaces_one_that_turned_out_to_be_worse() -> None:
    good, _ = constant_updates(lambda number: 1.5)
    wide = replace(TRAINING, kernel=replace(TRAINING.kernel, bandwidth=(1e4,)))
    (first,) = learn(replace(wide, iterations=1, algorithm=good))
    failed = replace(first.state, explorer=constant(-1.5), earlier=(first.state.explorer,))
    bad, _ = constant_updates(lambda number: -0.1 * number)
    (second,) = learn(replace(wide, iterations=2, algorithm=bad), failed)
    points = first.exploration.flat(first.exploration.observations)
    np.testing.assert_allclose(second.policy.mean(points), first.policy.mean(points), atol=1e-3)
    assert second.state.earlier[0] is failed.explorer
    assert second.state.earlier[1] is first.state.explorer


def test_training_ends_if_no_policy_improves() -> None:
    algorithm, updates = constant_updates(lambda number: 1.0)
    learn(replace(TRAINING, iterations=1, algorithm=algorithm))
    assert updates == list(range((1 + 6) * 5))  # all policies are equal to the first candidate


def test_training_goes_on_as_long_as_policies_improve() -> None:
    algorithm, updates = constant_updates(lambda number: 0.02 * number)
    (iteration,) = learn(replace(TRAINING, iterations=1, algorithm=algorithm), task=Push)
    assert updates == list(range(SMALL.updates))
    assert iteration.policy.mean.weights[0, 0] == 0.02 * updates[-1]


def test_training_may_return_to_the_last_five_policies_before_the_newest() -> None:
    quick = replace(TRAINING, iterations=7, evaluate_every=0, model=replace(SMALL, updates=1))
    iterations = learn(quick)
    assert [len(each.state.earlier) for each in iterations] == [1, 2, 3, 4, 5, 5, 5]
    assert iterations[-1].state.earlier[0] is iterations[-2].state.explorer
