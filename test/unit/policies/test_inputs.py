from dataclasses import replace

import numpy as np
from hypothesis import given, strategies as st

from rkhs_ros.learning.model.transitions import Transitions
from rkhs_ros.learning.replay import check_actions
from rkhs_ros.learning.state import first_policy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.messages import policy_message, policy_of as policy_in
from rkhs_ros.policies.storage import policy_arrays, policy_of
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.recordings.definitions import Types
from rkhs_ros.rkhs.kernels import Polynomial
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import model_free, random_policy


def window(inputs: Inputs, observations: np.ndarray, actions: np.ndarray, t: int) -> list[float]:
    """Return the last observations up to step t, each with the preceding action, by the definition."""
    numbers: list[float] = []
    for k in range(t - inputs.history + 1, t + 1):
        o = observations[max(k, 0)]
        numbers += [np.sin(o[c]) for c in inputs.columns] + [np.cos(o[c]) for c in inputs.columns]
        numbers += [o[c] for c in range(len(o)) if c not in inputs.columns]
        if inputs.history > 1:
            numbers += list(actions[k - 1]) if k > 0 else [0.0] * actions.shape[1]
    return numbers


@given(
    history=st.sampled_from([1, 2, 5]),
    angles=st.sampled_from([(), (0,), (2,), (2, 0)]),
    horizon=st.integers(1, 8),
    rows=st.integers(1, 3),
    n=st.integers(1, 2),
    seed=st.integers(0, 999),
)
def test_inputs_match_the_definition_of_the_window(
    history: int, angles: tuple[int, ...], horizon: int, rows: int, n: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    inputs = Inputs(history=history, angles=tuple(map(float, angles)) or "none")
    observations, actions = rng.normal(size=(rows, horizon, 3)), rng.normal(size=(rows, horizon, n))
    expected = [[window(inputs, o, a, t) for t in range(horizon)] for o, a in zip(observations, actions, strict=True)]
    points = inputs.unfold(observations, actions)
    assert points.shape == (rows, horizon, inputs.dimension(3, n))
    np.testing.assert_array_equal(points, expected)


def test_windows_contain_the_clipped_actions_everywhere(rng: np.random.Generator) -> None:
    runner, batch = InlineRunner(Simulation("rkhs/Pendulum-v0")), Batch(3, 20, 4, 9, explore=True)
    inputs, wide = Inputs(history=3).within(runner.spaces), ConstantVariance(np.array([400.0]))
    policy = replace(random_policy(rng, d=9, n=1), inputs=inputs, variance=wide)
    episodes = runner.collect(policy, batch)
    clipped = np.clip(episodes.actions, runner.spaces.action_low, runner.spaces.action_high)
    assert not np.array_equal(clipped, episodes.actions)
    windows = replace(episodes, actions=clipped).with_inputs(Inputs(history=3)).observations
    np.testing.assert_array_equal(episodes.with_inputs(inputs).observations, windows)
    np.testing.assert_array_equal(
        Transitions.of(episodes, inputs, runner.spaces).points[:, :-1], windows.reshape(36, 9)
    )
    for again in (policy, policy_of(policy_arrays(policy)), policy_in(policy_message(Types(), policy, 1))):
        check_actions(episodes, again, batch)
    start = first_policy(model_free(inputs=Inputs(history=3)), runner.spaces).inputs
    assert (start.action_low, start.action_high) == ((inputs.action_low), (inputs.action_high))


@given(
    d=st.integers(1, 4),
    degree=st.integers(1, 6),
    offset=st.sampled_from([1e-9, 0.01, 0.2, 1.0, 7.0]),
    seed=st.integers(0, 999),
)
def test_inner_products_of_monomials_match_the_polynomial_kernel(d: int, degree: int, offset: float, seed: int) -> None:
    x, y = np.random.default_rng(seed).normal(size=(2, 5, d))
    inputs = Inputs(degree=degree, offset=offset)
    phi, psi = inputs.features(x), inputs.features(y)
    assert phi.shape[1] == inputs.dimension(d, 1)
    scale = (np.abs(x) @ np.abs(y).T + offset) ** degree  # size of the rounding errors if terms cancel
    assert np.all(np.abs(phi @ psi.T - Polynomial(offset, degree)(x, y)) <= 1e-12 * scale)


@given(
    turn=st.sampled_from([360.0, 6400.0, 1.0, 2.0 * np.pi]),
    history=st.integers(1, 3),
    degree=st.integers(0, 2),
    seed=st.integers(0, 999),
)
def test_angles_in_other_units_give_the_inputs_of_radians(turn: float, history: int, degree: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    radians = Inputs(history=history, angles=(2.0, 0.0), degree=degree)
    other = replace(radians, turns=(turn, 2.0 * np.pi))  # only column 2 is in other units
    observations, actions = rng.uniform(-9.0, 9.0, (2, 6, 3)), rng.normal(size=(2, 6, 1))
    scaled = observations * [1.0, 1.0, turn / (2.0 * np.pi)]
    expected = radians.unfold(observations, actions)
    np.testing.assert_allclose(other.unfold(scaled, actions), expected, atol=1e-12, rtol=1e-10)
