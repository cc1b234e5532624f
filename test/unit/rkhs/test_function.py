from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.rkhs.function import BLOCK_ROWS, Function, grid
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial
from rkhs_ros.rkhs.pursuit import sparsify
from rkhs_ros.rkhs.regression import ridge_regression
from test.unit.conftest import inner

KERNELS: list[Kernel] = [RBF((0.8, 1.4)), Polynomial(1.0, 3), RBF((1.0,)) + Polynomial(0.5, 1)]
over_kernels = pytest.mark.parametrize("kernel", KERNELS, ids=str)


def random_function(kernel: Kernel, seed: int, centres: int = 6, output_dim: int = 2) -> Function:
    rng = np.random.default_rng(seed)
    return Function(kernel, rng.normal(size=(centres, 2)), rng.normal(size=(centres, output_dim)))


@over_kernels
@given(seed=st.integers(0, 1000))
def test_the_inner_product_with_a_kernel_function_reproduces_the_value(kernel: Kernel, seed: int) -> None:
    h, x = random_function(kernel, seed), np.random.default_rng(seed + 1).normal(size=(1, 2))
    values = [inner(h, Function(kernel, x, unit[None])) for unit in np.eye(2)]
    np.testing.assert_allclose(h(x)[0], values, rtol=1e-9, atol=1e-9)


@over_kernels
@given(seed=st.integers(0, 1000), factor=st.floats(-5, 5))
def test_values_are_linear_in_the_function(kernel: Kernel, seed: int, factor: float) -> None:
    h, g = random_function(kernel, seed, 3), replace(random_function(kernel, seed + 1, 5), bias=(0.7, -2.0))
    x = np.random.default_rng(seed + 2).normal(size=(4, 2))
    np.testing.assert_allclose((h + g.scale(factor))(x), h(x) + factor * g(x), rtol=1e-9, atol=1e-9)


@over_kernels
def test_a_bias_is_added_to_all_values_and_stays_in_sums_and_sparsified_functions(kernel: Kernel) -> None:
    h, x = random_function(kernel, 0), np.random.default_rng(1).normal(size=(30, 2))
    shifted = replace(h, bias=(5.0, -1e3))
    np.testing.assert_allclose(shifted(x), h(x) + np.array([5.0, -1e3]), rtol=1e-12)
    np.testing.assert_allclose((shifted + shifted)(x), 2.0 * shifted(x), rtol=1e-12)
    few, unshifted = sparsify(shifted, x, budget=3), sparsify(h, x, budget=3)
    assert np.array_equal(few.chosen, unshifted.chosen)
    np.testing.assert_allclose(few.function(x), unshifted.function(x) + np.array([5.0, -1e3]), rtol=1e-12)


def test_the_zero_function_is_zero_everywhere_and_neutral(rng: np.random.Generator) -> None:
    kernel, x = KERNELS[0], rng.normal(size=(5, 2))
    zero, h = Function.constant(kernel, 2, 3), random_function(kernel, 0, output_dim=3)
    assert np.array_equal(zero(x), np.zeros((5, 3)))
    assert np.array_equal((zero + h)(x), h(x))


def test_values_do_not_depend_on_the_memory_order_of_centres_and_weights(rng: np.random.Generator) -> None:
    centres, weights, x = rng.normal(size=(41, 4)), rng.normal(size=(41, 3)), rng.normal(size=(100, 4))
    for kernel in (RBF((2.0,)), Polynomial(1.0, 3)):
        by_rows = Function(kernel, centres, weights)
        by_columns = Function(kernel, np.asfortranarray(centres), np.asfortranarray(weights))
        assert np.array_equal(by_rows(x), by_columns(x))


def test_a_function_copies_its_arrays() -> None:
    centres, weights = np.ones((2, 1)), np.ones((2, 1))
    h = Function(RBF((1.0,)), centres, weights)
    before = h(np.zeros((1, 1)))
    centres[:], weights[:] = 7.0, 7.0
    assert np.array_equal(h(np.zeros((1, 1))), before)
    with pytest.raises(ValueError, match="read-only"):
        h.weights[0, 0] = 2.0


@pytest.mark.parametrize(
    ("centres", "weights", "message"),
    [
        (np.zeros((3, 2)), np.zeros((2, 1)), "weights: expected 3 rows, got 2"),
        (np.zeros((1, 1)), np.full((1, 1), np.inf), "weights: expected finite numbers"),
    ],
)
def test_mismatched_shapes_and_non_finite_numbers_are_rejected(
    centres: np.ndarray, weights: np.ndarray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Function(RBF((1.0,)), centres, weights)


def test_adding_functions_of_different_spaces_raises() -> None:
    with pytest.raises(ValueError, match="sum of functions"):
        random_function(KERNELS[0], 0) + random_function(KERNELS[1], 0)


@over_kernels
def test_a_sum_shares_equal_centres(kernel: Kernel, rng: np.random.Generator) -> None:
    h, x = random_function(kernel, 0), rng.normal(size=(9, 2))
    g = Function(kernel, h.centres.copy(), rng.normal(size=h.weights.shape))
    total = h + g
    assert np.array_equal(total.centres, h.centres)
    np.testing.assert_allclose(total(x), h(x) + g(x), rtol=1e-12, atol=1e-12)


def test_a_grid_contains_each_combination_once() -> None:
    points = grid(np.array([-1.0, 0.0, 10.0]), np.array([1.0, 3.0, 20.0]), (3, 4, 2))
    expected = {(a, b, c) for a in (-1.0, 0.0, 1.0) for b in (0.0, 1.0, 2.0, 3.0) for c in (10.0, 20.0)}
    assert points.shape == (24, 3)
    assert set(map(tuple, points.tolist())) == expected


def test_a_single_point_along_a_dimension_lies_in_its_middle() -> None:
    assert grid(np.array([-1.0, 2.0]), np.array([3.0, 4.0]), (1, 2)).tolist() == [[1.0, 2.0], [1.0, 4.0]]


def test_a_function_at_many_points_is_bit_identical_to_single_points(rng: np.random.Generator) -> None:
    function = Function(RBF((0.7,)), rng.normal(size=(5, 2)), rng.normal(size=(5, 3)))
    points = rng.normal(size=(2 * BLOCK_ROWS + 3, 2))
    values = function(points)
    assert values.shape == (len(points), 3)
    for i in (0, BLOCK_ROWS - 1, BLOCK_ROWS, 2 * BLOCK_ROWS + 2):
        assert values[i].tobytes() == function(points[i : i + 1]).tobytes()


@pytest.mark.parametrize("rows", [4, 40])
def test_a_penalty_below_the_rounding_errors_gives_a_finite_solution(rows: int, rng: np.random.Generator) -> None:
    one = rng.normal(size=(rows, 1))
    features, targets = 1e9 * np.repeat(one, 12, axis=1), one
    solution = ridge_regression(features, targets, np.full(12, 1e-2))
    np.testing.assert_allclose(features @ solution, targets, rtol=1e-4)


@given(n=st.integers(1, 30), p=st.integers(1, 8), k=st.integers(1, 3), weighted=st.booleans(), seed=st.integers(0, 999))
def test_ridge_regression_is_least_squares_on_the_augmented_system(
    n: int, p: int, k: int, weighted: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    features, targets = rng.normal(size=(n, p)), rng.normal(size=(n, k))
    penalty, weights = 10 ** rng.uniform(-3, 1, p), rng.uniform(0, 3, n) if weighted else None
    roots = np.sqrt(np.ones(n) if weights is None else weights)[:, None] / np.sqrt(n)
    design = np.concatenate([roots * features, np.diag(np.sqrt(penalty))])
    expected = np.linalg.lstsq(design, np.concatenate([roots * targets, np.zeros((p, k))]))[0]
    np.testing.assert_allclose(ridge_regression(features, targets, penalty, weights), expected, rtol=1e-6, atol=1e-9)
