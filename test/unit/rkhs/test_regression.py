import numpy as np
import pytest

from rkhs_ros.rkhs.function import BLOCK_ROWS, Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rkhs.regression import relative_ridge_regression, ridge_regression


@pytest.mark.parametrize("intercept", [True, False])
@pytest.mark.parametrize("n", [5, 60], ids=["wide", "tall"])
def test_a_relative_ridge_regression_is_least_squares_on_the_augmented_system(
    rng: np.random.Generator, n: int, intercept: bool
) -> None:
    features, targets = rng.normal(1.0, 2.0, size=(n, 6)), rng.normal(3.0, 1.0, size=n)
    penalty = np.sqrt(0.2 * np.sum(features**2) / n)
    design = np.block([[features, np.full((n, 1), float(intercept))], [penalty * np.eye(6), np.zeros((6, 1))]])
    expected = np.linalg.lstsq(design, np.append(targets, np.zeros(6)))[0][:6]
    np.testing.assert_allclose(
        relative_ridge_regression(features, targets, 0.2, intercept=intercept), expected, rtol=1e-9
    )


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
