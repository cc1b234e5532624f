"""Signs that a run does not learn, on short curves and episodes."""

from collections.abc import Callable
from dataclasses import replace
from math import nan

import gymnasium
import numpy as np
import pytest

from rkhs_ros.learning.diagnosis import (
    SIGNS,
    Summary,
    advice_on,
    exploits_model,
    has_constant_reward,
    is_always_cut,
    predicts_badly,
    saturates,
    summary_of,
)
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import model_free

Sign = Callable[[list[Summary]], bool]
GOOD = (4.0, 24.0, 35.0, 41.0, 43.0, 45.0, 46.0, 46.0)  # evaluation returns of a cart-pole
PENDULUM = (-166, -246, -302, -380, -144, -123, -157, -167, -213, -125, -160, -219)  # of Pendulum-v1, random starts
PENDULUM_MODEL = (-104, -53, -32, -31, -61, -71, -54, -49, -60, -101, -70, -76)
ERRORS = (nan, 0.3, 0.1, 0.04, 0.03, 0.02, 0.02, 0.02)


def known(evaluation: float, **values: float | bool) -> Summary:
    usual = Summary(1.0, evaluation, evaluation, 0.3, lowest_reward=0.0, highest_reward=1.0)
    return replace(usual, **values)  # type: ignore[arg-type]


def curve(count: int = 8, **values: float | bool) -> list[Summary]:
    return [known(1.4, **values) for _ in range(count)]


def errors(*values: float) -> list[Summary]:
    return [known(1.4, exploration_return=0.0, model_return=2.0, model_error=value) for value in values]


def of_model(*values: float) -> list[Summary]:
    return [known(76.0, exploration_return=17.0, model_return=value) for value in values]


HEALTHY = [known(value, model_error=error) for value, error in zip(GOOD, ERRORS, strict=True)]
BAD: list[tuple[Sign, list[Summary]]] = [
    (has_constant_reward, curve(3, highest_reward=0.0)),
    (is_always_cut, curve(3, is_cut=True)),
    (saturates, curve(saturated=0.99)),
    (saturates, curve(5, saturated=0.99)),
    (saturates, [known(1.4, saturated=0.99 if each % 3 == 0 else nan) for each in range(15)]),  # evaluate_every=3
    (predicts_badly, curve(model_return=0.9, model_error=1.2)),
    (predicts_badly, curve(evaluation_return=nan, model_error=1.2)),
    (predicts_badly, curve(evaluation_return=nan, model_error=0.55)),
    (predicts_badly, curve(model_return=1.59, model_error=0.8)),  # 0.12 of the return above
    (predicts_badly, errors(nan, 6.4, 0.8, 0.4, 0.7)),  # a swimmer
    (exploits_model, curve(model_return=23.0)),
    (exploits_model, curve(exploration_return=-500.0, evaluation_return=-600.0, model_return=-100.0)),
    (exploits_model, curve(exploration_return=0.0, evaluation_return=1.0, model_return=1.8)),
    (exploits_model, of_model(1740.0, 926.0, 784.0, 248.0, 20.0, 219.0)),
]


@pytest.mark.parametrize(("sign", "bad"), BAD)
def test_each_sign_has_its_advice(sign: Sign, bad: list[Summary]) -> None:
    (advice,) = [advice for is_sign, advice in SIGNS if is_sign is sign]
    assert advice_on(bad) == [advice]
    assert advice_on(bad[:2]) == []  # two iterations may be luck


def test_a_run_that_learns_and_one_that_has_learnt_get_no_advice() -> None:
    assert all(advice_on(HEALTHY[: k + 1]) == [] for k in range(len(HEALTHY)))
    assert advice_on([*HEALTHY, *[HEALTHY[-1]] * 20]) == []


def test_random_starts_get_no_advice() -> None:
    pairs = zip(PENDULUM, PENDULUM_MODEL, strict=True)
    run = [known(value, exploration_return=-489.0, model_return=model, model_error=0.01) for value, model in pairs]
    assert all(advice_on(run[: k + 1]) == [] for k in range(len(run)))


def test_unknown_values_get_no_advice() -> None:
    assert advice_on([Summary(1.0)] * 20) == []


@pytest.mark.parametrize(
    "ordinary",
    [
        curve(exploration_return=-300.0, evaluation_return=-200.0, model_return=-130.0),  # random starts
        of_model(1740.0, 926.0, 784.0, 115.0, 115.0, 248.0),
        of_model(926.0, 784.0, 248.0, 219.0, 115.0),  # it becomes better
        [known(250.0, exploration_return=250.0, model_return=250.0 + 1e-9)] * 8,
        curve(highest_reward=0.0, terminates=True),  # such as 1 for each step without a fall
        curve(saturated=0.9),
        curve(4, saturated=0.99),
        curve(exploration_return=0.0, evaluation_return=1.0, model_return=1.7),
        curve(model_return=1.52, model_error=0.8),  # 0.08 of the return above
        errors(nan, 0.45, 0.45, 0.45, 0.45),
        curve(model_return=1.5, model_error=0.8),  # columns that do not matter
        curve(evaluation_return=nan, exploration_return=7.8, model_return=8.2, model_error=0.8),  # a robot
        errors(nan, 1.4, 0.2, 0.3, 0.2, 0.3),  # states that are new for one iteration
        errors(nan, 2.6, 0.7, 0.3, 0.2, 0.1, 0.1),  # a model that becomes better
        errors(nan, 2.6, 0.7, 0.9),
        [known(1.4, exploration_return=1.0, model_error=1e-5)] * 8,
    ],
)
def test_ordinary_runs_get_no_advice(ordinary: list[Summary]) -> None:
    assert advice_on(ordinary) == []


TRAINING = model_free(
    iterations=3, episodes_per_iteration=2, evaluation_episodes=2, horizon=20, model=ModelBased(updates=2)
)


@pytest.fixture(scope="module")
def toy() -> list[Iteration]:
    return list(train(TRAINING, InlineRunner(Simulation("rkhs/Toy-v0"))))


def test_the_summary_of_an_iteration_has_its_figures(toy: list[Iteration]) -> None:
    spaces, last = InlineRunner(Simulation("rkhs/Toy-v0")).spaces, toy[-1]
    summary = summary_of(last, last.exploration, last.evaluation, spaces)
    assert (summary.evaluation_return, summary.model_error) == (last.evaluation_return, last.model_error)
    rewards = np.concatenate([last.exploration.rewards, last.evaluation.rewards])
    assert (summary.lowest_reward, summary.highest_reward) == (rewards.min(), rewards.max())
    assert (summary.terminates, summary.is_cut) == (False, False)
    wide = replace(last.evaluation, actions=last.evaluation.actions + 100.0)
    assert summary_of(last, last.exploration, wide, spaces).saturated == 1.0


def test_a_task_that_truncates_its_episodes_is_noticed() -> None:
    def env() -> gymnasium.Env[np.ndarray, np.ndarray]:
        return gymnasium.wrappers.TimeLimit(gymnasium.make("rkhs/Toy-v0"), 10)

    runner = InlineRunner(Simulation(env))
    for each in train(TRAINING, runner):
        assert summary_of(each, each.exploration, each.evaluation, runner.spaces).is_cut
