import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.wrappers import TransformAction

from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.step_rules import LineSearch
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.state import first_policy, first_state
from rkhs_ros.learning.training import Collector, train
from rkhs_ros.learning.training_settings import ModelBased, NoModel
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import RBF, median_bandwidth
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import columns
from test.unit.conftest import model_free

SHORT = model_free(iterations=3, episodes_per_iteration=4, evaluation_episodes=2, horizon=10, exploration_sd=(0.5,))
CONFIG = Path(__file__).parents[3] / "config"


def test_actions_are_learnt_relative_to_the_middle_of_their_bounds() -> None:
    def moved(middle: float, model: NoModel | ModelBased) -> Iteration:
        def make() -> gym.Env[Any, Any]:
            task = gym.make("rkhs/Pendulum-v0")
            bounds = Box(middle - 3.0, middle + 3.0, (1,), np.float64)
            return TransformAction(task, lambda action: action - middle, bounds)

        training = replace(SHORT, horizon=60, iterations=2, exploration_sd="range", model=model)
        *_, last = train(training, InlineRunner(Simulation(make)))
        return last

    plain, far = moved(0.0, NoModel()), moved(2.0, NoModel())
    assert plain.policy.mean.bias == ()
    assert far.policy.mean.bias == (2.0,)
    np.testing.assert_allclose(far.exploration.actions - 2.0, plain.exploration.actions, atol=0.01)
    assert moved(2.0, ModelBased(updates=3, rollouts=8, centres=30)).policy.mean.bias == (2.0,)
    np.testing.assert_allclose(far.evaluation.rewards, plain.evaluation.rewards, atol=0.01)


def test_the_first_policy_has_mean_0_and_the_given_deviations() -> None:
    policy = first_policy(model_free(exploration_sd=(0.5, 2.0)), Spaces.unbounded(3, 2))
    assert np.array_equal(policy.mean(np.ones((4, 3))), np.zeros((4, 2)))
    assert policy.variance.values.tolist() == [0.25, 4.0]
    alike = first_policy(model_free(exploration_sd=(0.5,)), Spaces.unbounded(3, 2))
    assert alike.variance.values.tolist() == [0.25, 0.25]
    with pytest.raises(ValueError, match="exploration_sd: expected 1 or 3 numbers, got 2"):
        first_policy(model_free(exploration_sd=(0.5, 2.0)), Spaces.unbounded(3, 3))


def test_a_kernel_without_support_for_the_learnt_variance_is_rejected_early() -> None:
    def begin(**changes: object) -> None:
        cubic = model_free(kernel=KernelChoice("rbf + polynomial"), algorithm=ALGORITHMS["rkhs_power"](**changes))
        first_state(cubic, Spaces.unbounded(2, 1))

    with pytest.raises(
        ValueError, match=r"kernel: .* algorithm.variance=learnt \(use .* algorithm.variance=constant\)"
    ):
        begin(variance="learnt")
    begin(variance="constant")
    begin(variance="as_published")


class Watching:
    """A runner that stores its requests and results."""

    def __init__(self) -> None:
        self._runner = InlineRunner(Simulation("rkhs/Toy-v0"))
        self.spaces = self._runner.spaces
        self.batches: list[Batch] = []
        self.episodes: list[Episodes] = []

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        self.batches.append(batch)
        self.episodes.append(self._runner.collect(policy, batch))
        return self.episodes[-1]


def test_each_iteration_uses_new_episodes_and_reports_them() -> None:
    runner = Watching()
    iterations = list(train(SHORT, runner))
    assert [(i.number, i.episodes_used) for i in iterations] == [(1, 4), (2, 8), (3, 12)]
    for explore, numbers in ((True, range(12)), (False, range(6))):
        batches = [batch for batch in runner.batches if batch.explore is explore]
        assert [number for batch in batches for number in batch.episodes] == list(numbers)
    for i, trained, evaluated in zip(iterations, runner.episodes[::2], runner.episodes[1::2], strict=True):
        assert np.array_equal(i.evaluation.observations, evaluated.observations)
        assert np.array_equal(i.evaluation.rewards, evaluated.rewards)
        assert np.array_equal(i.exploration_returns, trained.returns(0.99))
        assert np.array_equal(i.evaluation_returns, evaluated.returns(0.99))
        assert (i.exploration_return, i.evaluation_return) == (
            i.exploration_returns.mean(),
            i.evaluation_returns.mean(),
        )


@pytest.mark.parametrize(("algorithm", "every"), [(RKHSNAC(), 2), (RKHSNAC(step=LineSearch()), 1)])
def test_evaluation_is_as_often_as_asked_and_all_exploring_steps_count(algorithm: RKHSNAC, every: int) -> None:
    runner = Watching()
    iterations = list(train(replace(SHORT, algorithm=algorithm, evaluate_every=every), runner))
    assert [len(i.evaluation) > 0 for i in iterations] == [i.number % every == 0 for i in iterations]
    assert all(len(i.tried) == (50 if every == 1 else 0) for i in iterations)
    steps = [sum(each.count for each in (i.exploration, *i.tried)) for i in iterations]
    assert [i.state.steps for i in iterations] == np.cumsum(steps).tolist()


def test_the_median_bandwidth_of_the_first_iteration_does_not_change() -> None:
    runner = Watching()
    iterations = list(train(SHORT, runner))
    first = runner.episodes[0]
    expected = RBF(median_bandwidth(first.flat(first.observations)))
    assert {i.policy.mean.kernel for i in iterations} == {expected}


@pytest.mark.filterwarnings("error")
def test_training_works_with_one_episode_of_one_step() -> None:
    tiny = model_free(iterations=2, episodes_per_iteration=1, evaluation_episodes=1, horizon=1)
    assert len(list(train(tiny, InlineRunner(Simulation("rkhs/Toy-v0"))))) == 2


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_mean_without_features_stays_0(algorithm: str) -> None:
    # At the toy's start, 0, the homogeneous polynomial kernel vanishes.
    choice = KernelChoice("polynomial", offset=0.0, degree=2)
    training = model_free(
        iterations=1, episodes_per_iteration=3, horizon=1, kernel=choice, algorithm=ALGORITHMS[algorithm]()
    )
    (iteration,) = train(training, InlineRunner(Simulation("rkhs/Toy-v0")))
    assert not iteration.policy.mean(iteration.evaluation.flat(iteration.evaluation.observations)).any()


class Numbered:
    """A runner whose observations are the numbers of the episodes."""

    spaces = Spaces.unbounded(2, 1)

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        shape = (batch.num_envs, batch.horizon)
        numbers = np.broadcast_to(np.array(batch.episodes)[:, None, None], (*shape, 2)).astype(float)
        rewards = np.full(shape, float(batch.explore))
        return Episodes.without_ends(numbers, np.zeros((*shape, 1)), rewards, np.ones(shape, bool))


def test_an_update_receives_its_number_and_the_memory_of_the_last_one() -> None:
    received: list[tuple[int, int, float]] = []

    class Keeping(RKHSNAC):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            received.append((experience.iteration, len(experience.memory), experience.discount))
            return super().update(policy, experience)

        def remembered(self, episodes: Episodes, discount: float) -> Episodes:
            return episodes.take(slice(len(received)))

    list(train(replace(SHORT, algorithm=Keeping(), discount=0.8), InlineRunner(Simulation("rkhs/Toy-v0"))))
    assert received == [(0, 0, 0.8), (1, 1, 0.8), (2, 2, 0.8)]


def test_no_episode_number_repeats_and_exploring_episodes_are_counted() -> None:
    inputs = Inputs(history=2)
    training = replace(SHORT, inputs=inputs, evaluation_episodes=3, horizon=4)
    collector = Collector(training, Numbered(), first_state(training, Numbered.spaces))
    policy = first_policy(training, Numbered.spaces)
    numbers: dict[bool, list[float]] = {True: [], False: []}
    asked = (
        (True, inputs.dimension(2, 1), lambda: collector.try_out(policy, 2)),
        (False, 2, lambda: collector.evaluate(policy)),
        (True, inputs.dimension(2, 1), lambda: collector.try_out(policy, 5)),
        (False, 2, lambda: collector.evaluate(policy)),
        (True, 2, lambda: collector.explore(policy, 4)),
        (True, 2, lambda: collector.explore(policy, 4)),
    )
    for explore, dimension, ask in asked:
        got = ask()
        assert got.observations.shape[2] == dimension
        assert (got.rewards == float(explore)).all()
        numbers[explore] += got.observations[:, 0, 0].tolist()
    assert numbers == {True: list(range(15)), False: list(range(6))}
    assert (collector.explored, collector.evaluated) == (15, 6)
    assert collector.steps == 4 * 15
    assert [len(each) for each in (collector.take_tried(), collector.take_tried())] == [2, 0]


@pytest.mark.slow
def test_rkhs_power_solves_the_toy_task() -> None:
    config = load_config(CONFIG / "toy_power.yaml", ["seed=0"])
    *_, last = train(config.training, InlineRunner(Simulation(config.environment.id, config.environment.options)))
    # The optimum is 14.5 and the first policy earns about 2; this seed ends at 14.5.
    assert last.evaluation_returns.mean() > 14.0


KEPT = Path(__file__).with_name("pendulum_nac_seed_0.csv")


# Processors and versions of libraries round differently, so only the first iterations agree to these digits.
SOME, DIGITS = 5, 1e-6


def test_the_pendulum_curve_agrees_with_the_reference() -> None:
    config = load_config(CONFIG / "pendulum_nac.yaml", ["seed=0"])
    runner = InlineRunner(Simulation(config.environment.id, config.environment.options))
    got = columns([iteration.row(0.0) for iteration in train(config.training, runner)])
    with KEPT.open(newline="") as file:
        lines = list(csv.DictReader(file))
    # The optimum is 51.8 and the first policy earns about 5; this seed ends at 51.5, so the margin is wide.
    assert got["evaluation_return"][-1] > 50.0
    for name in lines[0]:
        expected = [float(line[name]) for line in lines[:SOME]]
        np.testing.assert_allclose(got[name][:SOME], expected, rtol=DIGITS, atol=DIGITS, err_msg=name)
