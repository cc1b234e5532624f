"""The cart-pole swing-up: its equations, options, and pictures."""

import gymnasium
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rkhs_ros.app.inline import untuned_config
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.rollouts.simulation import Simulation
from sim_nodes.envs.cart_pole import CartPole

ID = "rkhs/CartPoleSwingUp-v0"


def energy(task: CartPole, states: np.ndarray) -> np.ndarray:
    """Return the energy of a cart and a thin rod, J."""
    _, v, angle, w = states.T
    m, length = task.mass, task.length
    moving = (task.cart_mass + m) * v**2 / 2 + m * length * v * w * np.cos(angle) / 2 + m * length**2 * w**2 / 6
    return np.asarray(moving - m * task.gravity * length / 2 * np.cos(angle))


def momentum(task: CartPole, states: np.ndarray) -> np.ndarray:
    """Return the momentum along the rail, N s."""
    _, v, angle, w = states.T
    return np.asarray((task.cart_mass + task.mass) * v + task.mass * task.length * w * np.cos(angle) / 2)


def test_energy_and_momentum_change_by_the_force_and_friction_only(rng: np.random.Generator) -> None:
    task, h = CartPole(), 1e-6
    states, force = rng.normal(size=(50, 4)) * [1.0, 2.0, 2.0, 5.0], rng.uniform(-10.0, 10.0, 50)
    moves = task.derivative(states.T, force).T
    before, after = states - h * moves, states + h * moves
    push = force - 0.1 * states[:, 1]
    power = (energy(task, after) - energy(task, before)) / (2 * h)
    np.testing.assert_allclose(power, push * states[:, 1], atol=1e-6)
    pulls = (momentum(task, after) - momentum(task, before)) / (2 * h)
    np.testing.assert_allclose(pulls, push, atol=1e-6)


@pytest.mark.parametrize("rate", [10.0, 33.0])
def test_steps_agree_with_an_adaptive_integrator_of_high_order(rate: float) -> None:
    task = CartPole(rate=rate)
    for start, force in (((0.1, -0.3, 0.4, 2.0), 10.0), ((0.0, 0.5, 3.0, -4.0), -7.0), ((-0.2, 0.0, 1.5, 12.0), 0.0)):
        exact = solve_ivp(
            lambda _, s, force=force: task.derivative(s[:, None], np.array([force]))[:, 0],
            (0.0, 1.0 / rate),
            start,
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
        ).y[:, -1]
        after = task.transition(np.array([start]), np.array([[force]]), np.empty((1, 0)))
        np.testing.assert_allclose(after[0], exact, atol=1e-6)


def test_rewards_by_hand() -> None:
    states = np.array([[0.0, 9.0, np.pi, 9.0], [0.5, 0.0, 0.0, 0.0], [0.0, 0.0, -3 * np.pi + 0.3, 0.0]])
    expected = [1.0, np.exp(-((np.pi / 3) ** 2) - 0.25), np.exp(-0.01)]
    np.testing.assert_allclose(CartPole(3).reward(states, states), expected, rtol=1e-12)
    narrow = [1.0, np.exp(-((np.pi / 0.6) ** 2) - 6.25), np.exp(-0.25)]
    np.testing.assert_allclose(CartPole(3, reward_width=0.6).reward(states, states), narrow, rtol=1e-12)
    np.testing.assert_allclose(CartPole(3, rate=50).reward(states, states), np.multiply(0.4, expected), rtol=1e-12)


@pytest.mark.parametrize(("rate", "steps"), [(20, 60), (7.5, 22), (1, 3)])
def test_an_episode_is_truncated_after_three_seconds_at_any_rate(rate: float, steps: int) -> None:
    single = gymnasium.make(ID, rate=rate)
    single.reset(seed=0)
    ends = [single.step(np.zeros(1))[2:4] for _ in range(steps)]
    assert ends == [(False, False)] * (steps - 1) + [(False, True)]
    task = CartPole(rate=rate)
    task.reset(seed=0)
    assert [task.step(np.zeros((1, 1)))[3].item() for _ in range(steps)] == [False] * (steps - 1) + [True]
    assert task.step_seconds == 1 / rate


def test_the_default_horizon_follows_the_rate() -> None:
    assert untuned_config(ID, []).training.horizon == 60
    assert untuned_config(ID, ["environment.options.rate=100"]).training.horizon == 300
    assert untuned_config(ID, ["environment.options.rate=100", "horizon=7"]).training.horizon == 7
    assert Simulation(ID, {"rate": 10}).time_limit == time_limit(gymnasium.make(ID, rate=10)) == 30
    assert time_limit(ID) == 60
    with pytest.raises(ValueError, match="rate: expected a number from 1 to 1000"):
        untuned_config(ID, ["environment.options.rate=fast"])


def test_each_environment_ends_and_restarts_alone_beyond_the_rail() -> None:
    task = CartPole(3, rail=0.3)
    task.reset(seed=[1, 2, 3])
    forces = np.array([[10.0], [0.0], [-5.0]])
    ends = []
    for _ in range(14):
        before = task._states.copy()
        observations, rewards, terminated, truncated, _ = task.step(forces)
        restarted = ends[-1] if ends else np.zeros(3, dtype=bool)
        assert np.array_equal(terminated, (np.abs(observations[:, 0]) > 0.3))
        assert (rewards[restarted] == 0.0).all()
        assert (np.abs(task._states[restarted]) < 0.06).all()
        moved = task.transition(before, forces, np.empty((3, 0)))
        np.testing.assert_array_equal(task._states[~restarted], moved[~restarted])
        assert not truncated.any()
        ends.append(terminated)
    counts = np.sum(ends, axis=0)
    assert counts[0] >= counts[2] > counts[1] == 0


def test_the_bodies_are_where_the_state_is() -> None:
    task = CartPole()
    states = np.array([[0.0, 0.0, 0.0, 0.0], [0.3, 0.0, np.pi / 2, 0.0], [-0.2, 0.0, np.pi, 0.0]])
    motion = task.motion(task.observe(states, np.empty(0)), np.array([[0.0], [10.0], [-10.0]]))
    cart, tip, target, force = motion.positions[:, 2], motion.positions[:, 4], motion.positions[:, 5], -1
    np.testing.assert_allclose(cart[:, 0], [0.0, 0.3, -0.2])
    np.testing.assert_allclose(tip[:, [0, 2]], [[0.0, -0.5], [0.8, 0.0], [-0.2, 0.5]], atol=1e-12)
    np.testing.assert_allclose(target[:, [0, 2]], [[0.0, 0.5]] * 3)
    np.testing.assert_allclose(motion.positions[:, force, 0] - cart[:, 0], [0.0, 0.5, -0.5], atol=1e-12)
    w, _, y, _ = motion.orientations[:, 3].T  # of the pole; its axis is (2 w y, 0, w^2 - y^2)
    axis = np.stack([2 * w * y, w**2 - y**2], axis=1)
    middle = motion.positions[:, 3][:, [0, 2]]
    np.testing.assert_allclose(middle + 0.25 * axis, tip[:, [0, 2]], atol=1e-12)
