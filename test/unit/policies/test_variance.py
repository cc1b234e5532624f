from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.policies.variance import ConstantVariance, KernelVariance
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial
from test.unit.conftest import kl_between, random_policy

GOOD = {
    "kernel": RBF((1.0,)),
    "centres": np.array([[0.0], [2.0]]),
    "mass": np.array([1.0, 3.0]),
    "values": np.array([[1.0], [4.0]]),
    "minimum": np.array([0.5]),
    "maximum": np.array([9.0]),
}


@given(
    seed=st.integers(0, 10_000),
    distance=st.floats(0, 1e8),
    mass_scale=st.sampled_from([1e-12, 1.0, 1e12]),
    value_scale=st.sampled_from([0.0, 1e-9, 1.0, 1e9]),
    kernel=st.sampled_from([RBF((0.1,)), RBF((1.0, 5.0)), Polynomial(1.0, 2), RBF((1.0,)) * Polynomial(1.0, 2)]),
)
def test_the_variance_is_within_its_bounds_everywhere(
    seed: int, distance: float, mass_scale: float, value_scale: float, kernel: Kernel
) -> None:
    rng = np.random.default_rng(seed)
    variance = KernelVariance(
        kernel,
        rng.normal(size=(6, 2)),
        mass_scale * rng.uniform(0.01, 1, 6),
        value_scale * rng.uniform(0, 2, (6, 3)),
        np.array([1e-4, 0.1, 1.0]),
        np.array([1e-3, 1.0, 1.0]),
    )
    there = variance(distance * rng.normal(size=(20, 2)))
    assert there.shape == (20, 3)
    assert np.all((there >= variance.minimum) & (there <= variance.maximum))  # false for nan


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kernel": Polynomial(1.0, 3)}, "variance kernel: expected one without negative values"),
        ({"kernel": RBF((1.0,)) + Polynomial(1.0, 1)}, "variance kernel: expected one without negative values"),
        ({"centres": np.empty((0, 1)), "mass": np.empty(0), "values": np.empty((0, 1))}, "expected at least one"),
        ({"mass": np.array([1.0, 0.0])}, "variance mass: expected"),
        ({"values": np.array([[1.0], [-1.0]])}, "variance values: expected numbers >= 0"),
        ({"minimum": np.array([0.0])}, "minimum: expected"),
        ({"maximum": np.array([0.4])}, "maximum: expected|minimum: expected"),
    ],
)
def test_invalid_variances_are_rejected(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        KernelVariance(**GOOD | changes)


def test_between_centres_the_variance_is_their_weighted_mean() -> None:
    near = np.exp(-0.5 * np.array([0.7, 1.3]) ** 2) * [1.0, 3.0]
    expected = (near @ [1.0, 4.0]) / near.sum()
    assert KernelVariance(**GOOD)(np.array([[0.7]]))[0, 0] == pytest.approx(expected, rel=1e-12)


def test_far_from_all_centres_the_variance_is_the_mean_by_mass() -> None:
    far = KernelVariance(**GOOD)(np.array([[1e6], [-1e6]]))
    np.testing.assert_allclose(far, (1.0 * 1.0 + 3.0 * 4.0) / 4.0, rtol=1e-12)


@given(sd=st.floats(0.01, 10), factor=st.floats(0, 1), minimum=st.floats(0.01, 10))
def test_decay_shrinks_the_standard_deviation_but_not_below_its_minimum(
    sd: float, factor: float, minimum: float
) -> None:
    decayed = float(np.sqrt(ConstantVariance(np.array([sd**2])).decay(factor, minimum).values[0]))
    # A standard deviation that starts below the minimum does not change.
    assert decayed == pytest.approx(min(sd, max(sd * factor, minimum)), rel=1e-9)


over_variances = pytest.mark.parametrize("learnt", [False, True], ids=["constant variance", "learnt variance"])


@over_variances
def test_mean_kl_is_the_closed_form_of_each_dimension(rng: np.random.Generator, learnt: bool) -> None:
    old, new, x = random_policy(rng, learnt=learnt), random_policy(rng, learnt=learnt), rng.normal(size=(6, 2))
    total = 0.0
    for row in x:
        m0, m1, v0, v1 = (f(row[None])[0] for f in (old.mean, new.mean, old.variance, new.variance))
        for j in range(2):
            total += np.log(np.sqrt(v1[j] / v0[j])) + (v0[j] + (m0[j] - m1[j]) ** 2) / (2 * v1[j]) - 0.5
    assert kl_between(old, new, x) == pytest.approx(total / 6, rel=1e-12)
    assert kl_between(old, old, x) == pytest.approx(0.0, abs=1e-12)


@over_variances
def test_actions_have_the_policys_mean_and_variance(rng: np.random.Generator, learnt: bool) -> None:
    policy, x = random_policy(rng, learnt=learnt), rng.normal(size=(1, 2))
    actions = policy.act(np.repeat(x, 40_000, axis=0), rng.standard_normal((40_000, 2)))
    sd = np.sqrt(policy.variance(x)[0])
    assert np.all(np.abs(actions.mean(axis=0) - policy.mean(x)[0]) < 5 * sd / 200)  # five standard errors
    np.testing.assert_allclose(actions.std(axis=0), sd, rtol=0.02)  # five standard errors of 0.35 %
