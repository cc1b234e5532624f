from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.gaussian_process import kernels as sklearn_kernels

from rkhs_ros.rkhs.kernels import (
    RBF,
    Kernel,
    Linear,
    Polynomial,
    Term,
    deviations,
    kernel_from_terms,
    median_bandwidth,
    spreads,
)

KERNELS: list[Kernel] = [
    RBF((0.7,)),
    RBF((0.5, 1.0, 2.0)),
    Polynomial(1.0, 1),
    Polynomial(0.5, 3),
    Linear((0.5, -1.0, 2.0), (0.3, 1.0, 4.0)),
    RBF((1.0,)) + Polynomial(1.0, 2),
    RBF((1.0,)) * Linear((0.0, 1.0, 0.0), (1.0, 2.0, 1.0)),
    RBF((1.0,)) * Polynomial(0.2, 2),
    RBF((1.0,)) * (RBF((2.0,)) + Polynomial(0.0, 4)) + Polynomial(1.0, 1),
]
over_all_kernels = pytest.mark.parametrize("kernel", KERNELS, ids=str)
numbers = st.floats(-3, 3).map(lambda x: round(x, 3))
points = st.integers(1, 8).flatmap(lambda n: arrays(np.float64, (n, 3), elements=numbers))
bandwidths = st.lists(st.floats(0.1, 10.0), min_size=3, max_size=3).map(tuple)


@over_all_kernels
@given(x=points)
def test_a_gram_matrix_is_positive_semi_definite_and_has_its_diagonal_and_rows(kernel: Kernel, x: np.ndarray) -> None:
    gram, near = kernel(x, x), kernel.to(x)
    np.testing.assert_allclose(gram, gram.T, rtol=1e-12)
    np.testing.assert_allclose(kernel.diagonal(x), np.diag(gram), rtol=1e-12)
    assert all(np.array_equal(near(x[i : i + 1])[0], gram[i]) for i in range(len(x)))
    assert not kernel.is_positive or gram.min() >= 0.0
    smallest = np.linalg.eigvalsh((gram + gram.T) / 2).min()
    assert smallest >= -1e-12 * max(np.trace(gram), 1.0)


@given(x=points, centres=points, bandwidth=bandwidths, place=st.sampled_from([-1e9, -1e3, 1e6]))
def test_centres_far_from_the_origin_lose_no_precision(
    x: np.ndarray, centres: np.ndarray, bandwidth: tuple[float, ...], place: float
) -> None:
    kernel = RBF(bandwidth)
    x, centres = np.round(x * 1024) / 1024, np.round(centres * 1024) / 1024  # so that the sums are exact
    moved = kernel.with_centres(centres + place)(x + place)
    np.testing.assert_allclose(moved, kernel(x, centres), rtol=1e-9, atol=1e-300)


@given(x=points, y=points, bandwidth=bandwidths)
def test_rbf_matches_scikit_learn_with_a_length_scale_per_dimension(
    x: np.ndarray, y: np.ndarray, bandwidth: tuple[float, ...]
) -> None:
    expected = sklearn_kernels.RBF(np.array(bandwidth))(x, y)
    np.testing.assert_allclose(RBF(bandwidth)(x, y), expected, rtol=1e-9, atol=1e-300)


def test_a_single_bandwidth_applies_to_all_dimensions(rng: np.random.Generator) -> None:
    x, y = rng.normal(size=(4, 3)), rng.normal(size=(5, 3))
    np.testing.assert_array_equal(RBF((0.3,))(x, y), RBF((0.3, 0.3, 0.3))(x, y))


@given(x=points, y=points, offset=st.floats(0, 5), degree=st.integers(1, 6))
def test_polynomial_matches_its_closed_form(x: np.ndarray, y: np.ndarray, offset: float, degree: int) -> None:
    expected = [[(sum(a * b for a, b in zip(p, q, strict=True)) + offset) ** degree for q in y] for p in x]
    np.testing.assert_allclose(Polynomial(offset, degree)(x, y), expected, rtol=1e-9, atol=1e-9)


@given(x=points, y=points, scale=bandwidths, centre=st.tuples(numbers, numbers, numbers))
def test_linear_matches_its_closed_form(
    x: np.ndarray, y: np.ndarray, scale: tuple[float, ...], centre: tuple[float, ...]
) -> None:
    expected = [
        [1.0 + sum((a - o) * (b - o) / s**2 for a, b, o, s in zip(p, q, centre, scale, strict=True)) for q in y]
        for p in x
    ]
    np.testing.assert_allclose(Linear(centre, scale)(x, y), expected, rtol=1e-9, atol=1e-9)


@given(x=points, y=points)
def test_sum_and_product_combine_values(x: np.ndarray, y: np.ndarray) -> None:
    rbf, polynomial = RBF((0.8,)), Polynomial(1.0, 3)
    np.testing.assert_array_equal((rbf + polynomial)(x, y), rbf(x, y) + polynomial(x, y))
    np.testing.assert_array_equal((rbf * polynomial)(x, y), rbf(x, y) * polynomial(x, y))


@over_all_kernels
def test_terms_rebuild_the_kernel(kernel: Kernel) -> None:
    assert kernel_from_terms(kernel.terms()) == kernel


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ([("rbff", (1.0,))], "unknown kernel 'rbff', did you mean 'rbf'"),
        ([], "expected one kernel in postfix order, got 0"),
        ([("sum", ())], "expected two kernels before it, got 0"),
        ([("rbf", (1.0,)), ("rbf", (1.0,)), ("sum", (1.0,))], "kernel 'sum' parameters: expected none, got 1 numbers"),
        ([("rbf", (1.0,))] * 1000 + [("sum", ())] * 999, "kernel terms: expected at most 100, got more"),
        ([("x\n" * 10**6, ())], r"unknown kernel 'x x .*\.\.\.', known: (\w+, )+\w+$"),
        ([("rbf", ())], "rbf bandwidth: expected"),
        ([("rbf", (float("nan"),))], "rbf bandwidth: expected positive finite numbers"),
        ([("polynomial", (-1.0, 2.0))], "polynomial offset: expected"),
        ([("polynomial", (1.0, 2.5))], "polynomial degree: expected"),
        ([("linear", (1.0, 2.0, 3.0))], "linear parameters: expected as many centres as scales, got 3 numbers"),
        ([("linear", (0.0, float("inf")))], "linear scale: expected positive finite numbers"),
    ],
)
def test_invalid_terms_are_rejected(terms: list[Term], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kernel_from_terms(terms)


def test_bandwidths_must_match_the_dimension() -> None:
    with pytest.raises(ValueError, match="expected 1 or 3 numbers for 3-dimensional points, got 2"):
        RBF((1.0, 2.0))(np.zeros((2, 3)), np.zeros((2, 3)))


@pytest.mark.parametrize("dimension", [1, 3, 17, 40])
@pytest.mark.parametrize(
    "make",
    [
        lambda d: RBF((0.9,)),
        lambda d: Polynomial(0.3, 3),
        lambda d: Linear((0.3,) * d, (0.7,) * d),
        lambda d: RBF((1.1,)) + Polynomial(1.0, 2),
    ],
    ids=["rbf", "polynomial", "linear", "sum"],
)
def test_a_row_does_not_depend_on_other_rows(
    make: Callable[[int], Kernel], dimension: int, rng: np.random.Generator
) -> None:
    x, y, kernel = rng.normal(size=(37, dimension)), rng.normal(size=(43, dimension)), make(dimension)
    for of in (lambda points: kernel(points, y), kernel.with_centres(y)):
        together = of(x)
        for size in (1, 2, 3, 8, 20):
            parts = [of(x[start : start + size]) for start in range(0, len(x), size)]
            assert np.array_equal(np.concatenate(parts), together)
        order = rng.permutation(len(x))
        assert np.array_equal(of(x[order]), together[order])


@given(arrays(np.float64, st.tuples(st.integers(2, 12), st.integers(1, 3)), elements=numbers))
def test_the_median_bandwidth_is_the_larger_of_median_distance_and_deviation(x: np.ndarray) -> None:
    rows = range(len(x))
    for bandwidth, column in zip(median_bandwidth(x), x.T, strict=True):
        median = np.median([abs(column[i] - column[j]) for i in rows for j in rows if i < j])
        assert bandwidth == pytest.approx(max(median, np.sqrt(np.mean((column - column.mean()) ** 2))) or 1.0)


def test_the_median_bandwidth_of_a_subset_approximates_that_of_all_points(rng: np.random.Generator) -> None:
    x = rng.normal(size=(3000, 1))
    x = x + 2 * np.sign(x)  # two clusters: most pairs are farther apart than the deviation, 2.9
    all_pairs = np.median(np.abs(x - x.T)[np.triu_indices(len(x), 1)])
    # Among 1000 points the median of |x - y| has a standard error of about 2 %; the margin is four of them.
    assert median_bandwidth(x)[0] == pytest.approx(all_pairs, rel=0.08)


@given(st.floats(1e-20, 1e20), st.floats(1e-6, 1.0), st.integers(0, 99))
def test_a_small_spread_around_a_large_value_is_preserved_in_any_units(size: float, part: float, seed: int) -> None:
    noise = np.random.default_rng(seed).normal(size=(50, 1))
    expected = median_bandwidth(size * (1.0 + part * noise) - size)[0]
    assert median_bandwidth(size * (1.0 + part * noise))[0] == pytest.approx(expected, rel=1e-6)


@given(arrays(np.float64, st.tuples(st.integers(1, 12), st.integers(1, 3)), elements=numbers), st.integers(0, 99))
def test_spreads_are_standard_deviations_and_weights_act_as_repeats(x: np.ndarray, seed: int) -> None:
    times = np.random.default_rng(seed).integers(1, 4, len(x))
    np.testing.assert_allclose(spreads(x), x.std(axis=0), atol=1e-12)
    np.testing.assert_allclose(spreads(x, times), np.repeat(x, times, axis=0).std(axis=0), atol=1e-12)
    np.testing.assert_array_equal(deviations(x), np.where(spreads(x) > 0, spreads(x), 1.0))


@pytest.mark.parametrize("value", [0.0, 0.1, -1e8 / 3, 1e-30 / 7])
def test_a_column_with_rounding_errors_only_has_no_spread(value: float) -> None:
    rounded = np.nextafter(value, np.tile([-np.inf, value, np.inf], 100)) if value else np.zeros(300)
    still = np.column_stack([np.full(300, value), rounded])
    assert spreads(still).tolist() == [0.0, 0.0]
    assert deviations(still).tolist() == [1.0, 1.0]
    assert median_bandwidth(still) == (1.0, 1.0)


def test_positivity_of_a_composed_kernel_follows_from_its_parts() -> None:
    odd, even, rbf, linear = Polynomial(1.0, 3), Polynomial(1.0, 2), RBF((1.0,)), Linear((0.0,), (1.0,))
    for kernel in (odd, linear):
        assert kernel(np.array([[2.0]]), np.array([[-2.0]])) < 0.0
    kernels = (rbf, even, rbf + even, rbf * even, odd, rbf + odd, even * odd, linear, rbf * linear)
    assert [kernel.is_positive for kernel in kernels] == [True] * 4 + [False] * 5
