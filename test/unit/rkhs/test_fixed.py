import numpy as np

from rkhs_ros.rkhs.fixed import FixedBasis, grid
from rkhs_ros.rkhs.kernels import RBF


def test_a_grid_contains_each_combination_once() -> None:
    points = grid(np.array([-1.0, 0.0, 10.0]), np.array([1.0, 3.0, 20.0]), (3, 4, 2))
    expected = {(a, b, c) for a in (-1.0, 0.0, 1.0) for b in (0.0, 1.0, 2.0, 3.0) for c in (10.0, 20.0)}
    assert points.shape == (24, 3)
    assert set(map(tuple, points.tolist())) == expected


def test_a_single_point_along_a_dimension_lies_in_its_middle() -> None:
    assert grid(np.array([-1.0, 2.0]), np.array([3.0, 4.0]), (1, 2)).tolist() == [[1.0, 2.0], [1.0, 4.0]]


def test_a_function_of_a_fixed_basis_has_the_coefficients_as_its_weights(rng: np.random.Generator) -> None:
    basis, coefficients, x = FixedBasis(RBF((0.7,)), rng.normal(size=(4, 2))), rng.normal(size=(4, 3)), np.ones((1, 2))
    function = basis.function(coefficients)
    assert np.array_equal(function.weights, coefficients)
    assert np.array_equal(function.centres, basis.centres)
    np.testing.assert_allclose(function(x), basis(x) @ coefficients, rtol=1e-12)
