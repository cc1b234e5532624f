"""The ball on a beam, the tanks and the Furuta pendulum obey their physics."""

import numpy as np
import pytest

from sim_nodes.envs.control_tasks import ARM_STOP, BEAM_HALF, GRAVITY, POLE_HALF, POLE_MASS, BallOnBeam, Furuta, Tanks
from sim_nodes.envs.vector_task import VectorTask


def after(task: VectorTask, state: tuple[float, ...], action: float, steps: int) -> np.ndarray:
    """Return the states at the start and after each step under a constant action, shape (steps + 1, d)."""
    states = [np.array([state])]
    for _ in range(steps):
        states.append(task.transition(states[-1], np.array([[action]]), np.empty((1, 0))))
    return np.concatenate(states)


def test_the_ball_rolls_down_a_tilted_beam_as_a_damped_body() -> None:
    tilt, drag, times = 0.1, 0.2, 0.02 * np.arange(26)
    x, v, angle = after(BallOnBeam(), (0.0, 0.0, tilt), 0.0, 25).T
    terminal = -5 / 7 * 9.81 * np.sin(tilt) / drag
    np.testing.assert_allclose(v, terminal * (1 - np.exp(-drag * times)), rtol=0.01)
    exact = terminal * (times - (1 - np.exp(-drag * times)) / drag)
    np.testing.assert_allclose(x, exact, atol=0.01)  # semi-implicit steps of 0.01 s lead by half a step
    assert (angle == tilt).all()


def test_a_ball_rests_in_the_middle_of_a_level_beam_and_a_fall_costs_six() -> None:
    task = BallOnBeam()
    np.testing.assert_array_equal(after(task, (0.0, 0.0, 0.0), 0.0, 50)[-1], [0.0, 0.0, 0.0])
    edge = np.array([[0.499, 1.0, 0.0], [-0.3, 0.0, 0.0]])
    assert task.terminations(task.transition(edge, np.zeros((2, 1)), np.empty((2, 0)))).tolist() == [True, False]
    np.testing.assert_allclose(task.reward(edge, np.zeros((2, 1))), [-6.0 - 0.02 * (0.499 / 0.3) ** 2, -0.02])
    assert BEAM_HALF == 0.5


@pytest.mark.parametrize("pump", [0.2, 0.5, 0.9])
def test_the_levels_settle_where_inflow_equals_outflow(pump: float) -> None:
    first, second, target = after(Tanks(), (0.3, 0.3, 0.4), pump, 2000)[-1]
    flow = 0.15 * pump
    assert (first, second) == pytest.approx(np.minimum([(flow / 0.12) ** 2, (flow / 0.1) ** 2], 1.5), rel=1e-6)
    assert target == 0.4


def energy(states: np.ndarray) -> np.ndarray:
    """Return the energy of arm and pole, from the velocities of points on a pole of uniform mass, J."""
    _, pole, arm_speed, pole_speed = states.T
    total = 1.2e-4 * arm_speed**2 / 2 + POLE_MASS * GRAVITY * POLE_HALF * np.cos(pole)
    for along, weight in zip(*np.polynomial.legendre.leggauss(4), strict=True):
        r = POLE_HALF * (1 + along)  # from the joint at the end of the arm
        out, beside, up = r * np.sin(pole) * arm_speed, 0.085 * arm_speed, -r * np.sin(pole) * pole_speed
        beside = beside + r * np.cos(pole) * pole_speed
        total = total + weight / 2 * POLE_MASS / 2 * (out**2 + beside**2 + up**2)
    return np.asarray(total)


def test_the_furuta_pendulum_changes_its_energy_by_friction_and_torque_only() -> None:
    task, rng, h = Furuta(), np.random.default_rng(0), 1e-6
    states, torque = rng.normal(size=(50, 4)) * [1.0, 2.0, 5.0, 10.0], rng.uniform(-0.05, 0.05, 50)
    speeds = states[:, 2:]
    turning = task.accelerations(states.T, torque).T
    moves = np.concatenate([speeds, turning], axis=1)
    power = (energy(states + h * moves) - energy(states - h * moves)) / (2 * h)
    expected = torque * speeds[:, 0] - 5e-4 * speeds[:, 0] ** 2 - 2e-5 * speeds[:, 1] ** 2
    np.testing.assert_allclose(power, expected, atol=1e-6)


def test_the_hanging_pole_rests_and_the_upright_one_falls() -> None:
    task = Furuta()
    hanging, upright = (after(task, (0.0, angle, 0.0, 0.0), 0.0, 100)[-1] for angle in (np.pi, 1e-3))
    np.testing.assert_allclose(hanging, [0.0, np.pi, 0.0, 0.0], atol=1e-9)
    assert abs(upright[1]) > 0.1
    assert np.abs(after(task, (0.0, np.pi, 0.0, 0.0), 1.0, 100)[:, 0]).max() == ARM_STOP
    assert task.reward(np.zeros((1, 4)), np.zeros((1, 1)))[0] == pytest.approx(1.0)
