import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, strategies as st

from sim_nodes.envs import TASKS
from sim_nodes.envs.control_tasks import BallOnBeam
from sim_nodes.envs.lever_stafford import Pendulum, PendulumPOMDP, Toy
from sim_nodes.envs.vector_task import VectorTask

over_tasks = pytest.mark.parametrize("task", TASKS)
VARIANTS: list[tuple[type[VectorTask], dict[str, Any]]] = [
    (Toy, {}),
    (Pendulum, {}),
    (Pendulum, {"angle": "wrap"}),
    (PendulumPOMDP, {}),
]
over_variants = pytest.mark.parametrize(
    ("cls", "options"), VARIANTS, ids=["toy", "pendulum", "wrapped pendulum", "pendulum seen in part"]
)


def play(task: VectorTask, actions: np.ndarray, seed: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the observations, the first included, and rewards of actions of shape (steps, rows, n)."""
    observations, rewards = [task.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, *_ = task.step(action)
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations), np.array(rewards)


@over_tasks
def test_gymnasiums_checker_passes(task: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")  # the actions are the paper's
        warnings.filterwarnings("ignore", message=".*Box observation space m.* value is .*infinity")  # so is its noise
        check_env(gymnasium.make(task, render_mode="rgb_array").unwrapped)


@over_tasks
def test_a_single_environment_equals_one_of_the_vector_environment(task: str, rng: np.random.Generator) -> None:
    cls, horizon = TASKS[task]
    single, vector = gymnasium.make(task), cls(num_envs=4, max_episode_steps=horizon)
    n = vector.single_action_space.shape[0]
    actions = rng.uniform(-4, 4, (horizon, 4, n))
    observations, rewards = play(vector, actions, [11, 12, 13, 14])
    first, _ = single.reset(seed=13)
    assert np.array_equal(first, observations[0, 2])
    over, t = False, 0
    while not over:
        observation, reward, terminated, truncated, _ = single.step(actions[t, 2])
        assert np.array_equal(observation, observations[t + 1, 2])
        assert reward == rewards[t, 2]
        assert truncated == (t == horizon - 1)
        over, t = terminated or truncated, t + 1
    assert t == horizon or task == "rkhs/BallOnBeam-v0"


def test_environments_that_end_at_different_times_are_independent(rng: np.random.Generator) -> None:
    seeds, horizon = [3, 4, 5], 40
    actions = np.array([1.0, -1.0, 0.0])[:, None] * np.ones((3 * horizon, 3, 1))
    together = play(BallOnBeam(3, horizon), actions, seeds)
    for row, seed in enumerate(seeds):
        alone = play(BallOnBeam(1, horizon), actions[:, row : row + 1], [seed])
        for a, b in zip(alone, together, strict=True):
            assert np.array_equal(a[:, 0], b[:, row])
    assert len({tuple(np.flatnonzero(each == 0.0)) for each in together[1].T}) > 1  # the steps that restart


def test_a_step_of_the_toy_is_the_papers_formula() -> None:
    state, action, noise = np.array([[0.5], [3.9]]), np.array([[0.7], [1.0]]), np.array([[-1.0], [2.0]])
    expected = [[0.5 + 0.7 - 0.11], [4.0]]  # the second is stopped at the end of [-4, 4]
    np.testing.assert_allclose(Toy(2).transition(state, action, noise), expected, rtol=1e-12)
    np.testing.assert_allclose(Toy(2).reward(state, action), [np.exp(-2.5), np.exp(-0.9)], rtol=1e-12)
    assert np.array_equal(Toy(2).reset(seed=0)[0], [[0.0], [0.0]])


@pytest.mark.parametrize("angle", ["clip", "wrap"])
def test_a_step_of_the_pendulum_is_the_papers_formula_twice(angle: str) -> None:
    theta, omega, torque, noise = 0.4, -1.2, 2.5, [1.0, -2.0, 0.5, 3.0]
    for e1, e2 in (noise[:2], noise[2:]):
        theta, omega = theta + 0.05 * omega + 0.02 * e1, omega + 0.05 * torque + 2 * 0.02 * e2
    after = Pendulum(angle=angle).transition(np.array([[0.4, -1.2]]), np.array([[torque]]), np.array([noise]))
    np.testing.assert_allclose(after, [[theta, omega]], rtol=1e-12)
    reward = Pendulum(angle=angle).reward(np.array([[0.4, -1.2]]), np.array([[torque]]))
    np.testing.assert_allclose(reward, [np.exp(-0.5 * 0.4**2)], rtol=1e-12)
    assert np.array_equal(Pendulum(angle=angle).reset(seed=0)[0], [[-np.pi, 0.0]])


@over_variants
def test_each_step_uses_the_next_draws_of_its_stream(
    cls: type[VectorTask], options: dict[str, Any], rng: np.random.Generator
) -> None:
    task, actions, seeds = cls(2, **options), rng.uniform(-1, 1, (300, 2, 1)), [11, 12]  # past two blocks of draws
    observations, rewards = play(task, actions, seeds)
    for row, seed in enumerate(seeds):
        stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
        state = cls(1, **options).initial_states(np.empty((1, 0)))
        seen = state[0] if cls is not PendulumPOMDP else state[0, :1] + 0.04 * stream.standard_normal(1)
        assert np.array_equal(observations[0, row], seen)
        for t in range(300):
            assert rewards[t, row] == task.reward(state, actions[t, row : row + 1])[0]
            state = task.transition(state, actions[t, row : row + 1], stream.standard_normal((1, cls.noise_dim)))
            seen = state[0] if cls is not PendulumPOMDP else state[0, :1] + 0.04 * stream.standard_normal(1)
            assert np.array_equal(observations[t + 1, row], seen)


angles = st.floats(-np.pi, np.pi)
velocities = st.floats(-4 * np.pi, 4 * np.pi)
draws = st.lists(st.floats(-5, 5), min_size=4, max_size=4)


@given(theta=angles, omega=velocities, torque=st.floats(-3, 3), noise=draws)
def test_the_wrapped_angle_equals_the_free_angle_modulo_whole_turns(
    theta: float, omega: float, torque: float, noise: list[float]
) -> None:
    step = np.array([[theta, omega]]), np.array([[torque]]), np.array([noise])
    wrapped = Pendulum(angle="wrap").transition(*step)[0]
    middle = theta + 0.05 * omega + 0.02 * noise[0]
    speed = np.clip(omega + 0.05 * torque + 0.04 * noise[1], -4 * np.pi, 4 * np.pi)
    turns = (wrapped[0] - (middle + 0.05 * speed + 0.02 * noise[2])) / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)
    assert -np.pi <= wrapped[0] < np.pi
    assert wrapped in Pendulum.single_observation_space


@over_variants
@given(seed=st.integers(0, 999), scale=st.sampled_from([1.0, 100.0, np.inf]))
def test_observations_stay_in_their_space_under_any_actions(
    cls: type[VectorTask], options: dict[str, Any], seed: int, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    actions = np.sign(rng.normal(size=(30, 3, 1))) * scale
    observations, rewards = play(cls(3, **options), actions, [1, 2, 3])
    assert all(o in cls.single_observation_space for o in observations.reshape(-1, observations.shape[-1]))
    assert np.all((rewards > 0) & (rewards <= 1))
