import numpy as np
import pytest

from rkhs_ros.rkhs.function import BLOCK_ROWS, Function
from rkhs_ros.rkhs.kernels import RBF, Array
from rkhs_ros.rkhs.regression import (
    MOST_IN_GRAM,
    relative_ridge_regression,
    ridge_regression,
    ridge_regression_by_blocks,
)


@pytest.mark.parametrize("block_rows", [7, 50, 99, 100, 1000])
def test_regression_by_blocks_matches_regression_of_all_rows(rng: np.random.Generator, block_rows: int) -> None:
    features, targets, penalty = rng.normal(size=(100, 6)), rng.normal(size=(100, 2)), rng.uniform(0.1, 1.0, 6)
    asked: list[int] = []

    def rows(block: slice) -> Array:
        asked.append(len(features[block]))
        return features[block]

    by_blocks = ridge_regression_by_blocks(rows, targets, penalty, block_rows)
    whole = ridge_regression(features, targets, penalty)
    np.testing.assert_allclose(by_blocks, whole, rtol=1e-10)
    assert (max(asked) <= block_rows, sum(asked)) == (True, 100)
    assert block_rows < 100 or by_blocks.tobytes() == whole.tobytes()


@pytest.mark.parametrize("intercept", [True, False])
@pytest.mark.parametrize("n", [5, 60, MOST_IN_GRAM + 1], ids=["wide", "tall", "without its Gram"])
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
