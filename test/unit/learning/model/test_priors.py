"""Priors replace learnt parts of the model, and errors name the failing function."""

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from rkhs_ros.base.endings import RunError
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel, prediction_error
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.learning.model.state_coordinates import StateCoordinates
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import load_config
from test.unit.learning.model.test_model_rollouts import (
    HORIZON,
    LIMIT,
    OVER,
    SPACES,
    batch_of,
    certain,
    linear,
    policy_of,
    reward as task_reward,
    simulated_episodes,
    transitions,
)

CONFIG = Path(__file__).parents[4] / "config" / "toy_model_nac.yaml"


def paid(observations: np.ndarray, actions: np.ndarray, following: np.ndarray) -> np.ndarray:
    return task_reward(observations, actions) - OVER * over(following)


def over(observations: np.ndarray) -> np.ndarray:
    return np.abs(observations[:, 0]) > LIMIT


def moved(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
    return linear(observations, actions) - observations


PRIOR_DYNAMICS = Priors(dynamics_fn=moved)


@pytest.fixture
def functions(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = ModuleType("known_task")
    vars(module).update(paid=paid, over=over, moved=moved)
    vars(module).update(
        fails=lambda *rows: 1 / 0,
        likely=lambda rows: np.linspace(0.0, 1.0, len(rows)),
        not_finite=lambda *rows: np.full(len(rows[0]), np.nan),
        column=lambda *rows: np.ones((len(rows[0]), 1)),
    )
    monkeypatch.setitem(sys.modules, "known_task", module)
    return module


def test_prior_rewards_and_termination_match_the_task_exactly(rng: np.random.Generator) -> None:
    priors = Priors(reward_fn=paid, termination_fn=over)
    model = DynamicsModel.fit(simulated_episodes(rng, rows=10, ending=True), Inputs(), SPACES, 30, priors)
    rollouts = ModelRunner(model).collect(policy_of(rng), batch_of(80))
    now, actions, following = transitions(rollouts)
    np.testing.assert_array_equal(rollouts.flat(rollouts.rewards), paid(now, np.clip(actions, -1, 1), following))
    assert 0.1 < rollouts.terminated.mean() < 1.0
    np.testing.assert_array_equal(rollouts.terminated, over(rollouts.final_observations))
    assert (rollouts.mask.sum(axis=1)[~rollouts.terminated] == HORIZON).all()


def test_a_prior_reward_may_be_undefined_after_the_end(rng: np.random.Generator) -> None:
    def defined(now: np.ndarray, actions: np.ndarray, then: np.ndarray) -> np.ndarray:
        assert not over(now).any()
        return task_reward(now, actions)

    priors = Priors(reward_fn=defined, termination_fn=over)
    model = DynamicsModel.fit(simulated_episodes(rng, rows=10, ending=True), Inputs(), SPACES, 30, priors)
    model = replace(model, starts=np.zeros((1, 2)), starts_vary=False)
    rollouts = ModelRunner(model, visited_starts=False).collect(policy_of(rng), batch_of(80))
    assert rollouts.terminated.any()


def test_prior_dynamics_leave_only_the_noise(rng: np.random.Generator) -> None:
    before, after = simulated_episodes(rng, rows=6), simulated_episodes(rng, rows=20)
    prior = prediction_error(before, after, Inputs(), SPACES, 30, PRIOR_DYNAMICS)
    now, actions, following = transitions(after)
    noise = (following - linear(now, actions)) / (following - now).std(axis=0)
    assert prior == pytest.approx(float(np.sqrt(np.mean(noise**2))), rel=0.1)
    few = simulated_episodes(rng, rows=1)
    prior, learnt = (prediction_error(few, after, Inputs(), SPACES, 30, parts) for parts in (PRIOR_DYNAMICS, Priors()))
    assert prior < learnt  # a dozen steps determine a linear system well, so the difference is small


def test_prior_and_learnt_dynamics_add_up(rng: np.random.Generator) -> None:
    half = Priors(dynamics_fn=lambda observations, actions: 0.5 * moved(observations, actions))
    model = DynamicsModel.fit(simulated_episodes(rng, rows=40), Inputs(), SPACES, 40, half)
    model = replace(model, state_delta=certain(model.state_delta))
    rollouts = ModelRunner(model).collect(policy_of(rng), batch_of(50))
    now, actions, following = transitions(rollouts)
    inside = (np.abs(following[:, 0]) < 0.9 * model.high[0]) & (np.abs(following[:, 1]) < 0.9 * model.high[1])
    np.testing.assert_allclose(following[inside], linear(now, actions)[inside], atol=0.3)


def test_known_rewards_and_changes_of_a_held_action_are_those_of_its_steps(rng: np.random.Generator) -> None:
    rows, repeat, horizon, discount, speed = 10, 3, 24, 0.9, np.array([0.5, 0.3])
    actions = np.repeat(rng.uniform(-1.0, 1.0, (rows, horizon // repeat, 1)), repeat, axis=1)
    angles = StateCoordinates.of(np.zeros((1, 2)), Inputs(angles=(0.0,)))
    path = [rng.uniform(-3.0, 3.0, (rows, 2))]
    for each in np.moveaxis(actions, 1, 0):
        path.append(angles.add(path[-1], each * speed))  # uniform motion, past half a turn

    def known(now: np.ndarray, actions: np.ndarray, then: np.ndarray) -> np.ndarray:
        return np.sin(now[:, 0]) + then[:, 1] ** 2 - 0.1 * actions[:, 0]

    moves = zip(path[:-1], np.moveaxis(actions, 1, 0), path[1:], strict=True)
    rewards = np.stack([known(now, a, then) for now, a, then in moves], 1)
    mask = np.ones((rows, horizon), dtype=bool)
    steps = Episodes(np.stack(path[:-1], 1), actions, rewards, mask, path[-1], np.zeros(rows, dtype=bool))
    decisions = steps.decisions(repeat, discount, SPACES)
    priors = Priors(reward_fn=known, action_repeat=repeat, discount=discount)
    model = DynamicsModel.fit(decisions, Inputs(angles=(0.0,)), SPACES, 20, priors)
    now, held, following = transitions(decisions)
    earned = decisions.flat(decisions.rewards)
    np.testing.assert_allclose(model.known_rewards(now, held, following), earned, atol=1e-12)
    moved = replace(priors, dynamics_fn=lambda observations, actions: actions * speed).moved(now, held)
    np.testing.assert_allclose(model.coordinates.difference(moved, following), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("fails", "model.reward_fn: known_task:fails: ZeroDivisionError: division by zero"),
        ("not_finite", "model.reward_fn: known_task:not_finite: values: expected finite numbers"),
        ("column", r"model.reward_fn: known_task:column: values: expected the shape \(24,\), got \(24, 1\)"),
    ],
)
def test_the_error_names_a_failing_function(
    functions: ModuleType, rng: np.random.Generator, name: str, message: str
) -> None:
    priors = ModelBased(reward_fn=f"known_task:{name}").priors(2)
    model = DynamicsModel.fit(simulated_episodes(rng, rows=3), Inputs(), SPACES, 10, priors)
    with pytest.raises(RunError, match=message):
        ModelRunner(model).collect(policy_of(rng), batch_of(2))


def test_termination_must_be_0_or_1(functions: ModuleType) -> None:
    priors = ModelBased(termination_fn="known_task:likely").priors(2)
    assert priors.termination_fn is not None
    with pytest.raises(RunError, match=r"model.termination_fn: known_task:likely: values: expected 0 or 1"):
        priors.termination_fn(np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("known_task:ovr", "model.termination_fn: no function 'ovr' in known_task, did you mean 'over'"),
        ("no_such_module:f", "model.termination_fn: expected an importable module 'no_such_module'"),
    ],
)
def test_a_run_does_not_start_without_its_functions(functions: ModuleType, name: str, message: str) -> None:
    config = load_config(CONFIG, [f"model.termination_fn={name}"])
    environment = config.environment
    with pytest.raises(ValueError, match=message):
        next(train(config.training, InlineRunner(Simulation(environment.id, environment.options))))


def test_user_functions_cannot_change_rollouts(functions: ModuleType, rng: np.random.Generator) -> None:
    def spoils(observations: np.ndarray, actions: np.ndarray, following: np.ndarray) -> np.ndarray:
        values = task_reward(observations, actions)
        observations[:], actions[:], following[:] = 7.0, 7.0, 7.0
        return values

    vars(functions)["spoils"] = spoils
    vars(functions)["clean"] = lambda o, a, f: task_reward(o, a)
    runs = []
    for name in ("spoils", "clean"):
        priors = replace(ModelBased(), reward_fn=f"known_task:{name}").priors(2)
        model = DynamicsModel.fit(simulated_episodes(np.random.default_rng(3), rows=5), Inputs(), SPACES, 20, priors)
        runs.append(ModelRunner(model).collect(policy_of(np.random.default_rng(4)), batch_of(5)))
    np.testing.assert_array_equal(runs[0].observations, runs[1].observations)
    np.testing.assert_array_equal(runs[0].actions, runs[1].actions)
    np.testing.assert_array_equal(runs[0].rewards, runs[1].rewards)
