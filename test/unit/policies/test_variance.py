import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.policies.variance import ConstantVariance, FunctionVariance, KernelVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial

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


def test_kernels_with_negative_values_are_rejected() -> None:
    for kernel in (Polynomial(1.0, 3), RBF((1.0,)) + Polynomial(1.0, 1)):
        with pytest.raises(ValueError, match="variance kernel: expected one without negative values"):
            KernelVariance(**{**GOOD, "kernel": kernel})


def test_between_centres_the_variance_is_their_weighted_mean() -> None:
    near = np.exp(-0.5 * np.array([0.7, 1.3]) ** 2) * [1.0, 3.0]
    expected = (near @ [1.0, 4.0]) / near.sum()
    assert KernelVariance(**GOOD)(np.array([[0.7]]))[0, 0] == pytest.approx(expected, rel=1e-12)


def test_far_from_all_centres_the_variance_is_the_mean_by_mass() -> None:
    far = KernelVariance(**GOOD)(np.array([[1e6], [-1e6]]))
    np.testing.assert_allclose(far, (1.0 * 1.0 + 3.0 * 4.0) / 4.0, rtol=1e-12)


def test_a_row_does_not_depend_on_other_rows(rng: np.random.Generator) -> None:
    x = np.concatenate([rng.normal(size=(20, 1)), [[1e6]], rng.normal(size=(20, 1))])
    variance = KernelVariance(**GOOD)
    assert np.array_equal(variance(x), np.concatenate([variance(row[None]) for row in x]))


@given(sd=st.floats(0.01, 10), factor=st.floats(0, 1), minimum=st.floats(0.01, 10))
def test_decay_shrinks_the_standard_deviation_but_not_below_its_minimum(
    sd: float, factor: float, minimum: float
) -> None:
    decayed = float(np.sqrt(ConstantVariance(np.array([sd**2])).decay(factor, minimum).values[0]))
    # A standard deviation that starts below the minimum does not change.
    assert decayed == pytest.approx(min(sd, max(sd * factor, minimum)), rel=1e-9)


@given(
    seed=st.integers(0, 10_000),
    distance=st.floats(0, 1e8),
    scale=st.sampled_from([0.0, 1e-9, 1.0, 1e9]),
    kernel=st.sampled_from([RBF((0.1,)), RBF((1.0, 5.0)), Polynomial(1.0, 2)]),
)
def test_a_function_variance_is_the_clipped_function(seed: int, distance: float, scale: float, kernel: Kernel) -> None:
    rng = np.random.default_rng(seed)
    function = Function(kernel, rng.normal(size=(6, 2)), scale * rng.normal(size=(6, 3)))
    low, high = np.array([1e-4, 0.1, 1.0]), np.array([1e-3, 1.0, 1.0])
    x = distance * rng.normal(size=(20, 2))
    there = FunctionVariance(function, low, high)(x)
    expected = [[min(max(g, a), b) for g, a, b in zip(row, low, high, strict=True)] for row in function(x)]
    assert np.array_equal(there, expected)
