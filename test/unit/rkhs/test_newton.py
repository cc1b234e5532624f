import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial
from rkhs_ros.rkhs.newton import NewtonBasis, pivoted_cholesky
from test.unit.conftest import inner

KERNELS: list[Kernel] = [RBF((0.6,)), RBF((1.5, 0.5)), Polynomial(1.0, 4), RBF((1.0,)) * Polynomial(1.0, 1)]
over_kernels = pytest.mark.parametrize("kernel", KERNELS, ids=str)
points = st.builds(
    lambda n, seed: np.random.default_rng(seed).normal(size=(n, 2)), st.integers(1, 25), st.integers(0, 999)
)


@over_kernels
@given(x=points)
def test_at_full_rank_the_factor_reproduces_the_gram_matrix(kernel: Kernel, x: np.ndarray) -> None:
    gram = kernel(x, x)
    values = pivoted_cholesky(kernel, x, rank=len(x), tolerance=1e-12).values
    np.testing.assert_allclose(values @ values.T, gram, atol=1e-9 * gram.max())


@over_kernels
@given(x=points, rank=st.integers(1, 25))
def test_power_is_the_diagonal_of_the_residual(kernel: Kernel, x: np.ndarray, rank: int) -> None:
    gram, chosen = kernel(x, x), pivoted_cholesky(kernel, x, rank)
    residual = np.diag(gram - chosen.values @ chosen.values.T)
    np.testing.assert_allclose(chosen.power, residual, atol=1e-11 * gram.max())
    np.testing.assert_array_equal(chosen.power[chosen.pivots], 0.0)
    triangle = chosen.values[chosen.pivots]
    assert np.array_equal(triangle, np.tril(triangle))
    assert len(set(chosen.pivots.tolist())) == len(chosen.pivots) <= min(rank, len(x))


@over_kernels
def test_each_pivot_is_the_point_farthest_from_the_span_so_far(kernel: Kernel, rng: np.random.Generator) -> None:
    x = rng.normal(size=(20, 2))
    gram, pivots = kernel(x, x), pivoted_cholesky(kernel, x, 6).pivots
    for k in range(6):
        span = pivots[:k]
        power = np.diag(gram - gram[:, span] @ np.linalg.solve(gram[np.ix_(span, span)], gram[span]))
        assert power[pivots[k]] == pytest.approx(power.max(), rel=1e-8)


@over_kernels
@given(seed=st.integers(0, 500))
def test_a_function_evaluates_as_coefficients_times_basis(kernel: Kernel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, elsewhere = rng.normal(size=(15, 2)), rng.normal(size=(9, 2))
    basis = NewtonBasis.of(kernel, x, pivoted_cholesky(kernel, x, 6))
    coefficients = rng.normal(size=(len(basis.centres), 3))
    np.testing.assert_allclose(basis.function(coefficients)(elsewhere), basis(elsewhere) @ coefficients, atol=1e-6)
    function = basis.function(coefficients)
    assert inner(function, function) == pytest.approx(np.sum(coefficients**2), rel=1e-6)


def test_repeated_points_are_selected_once(rng: np.random.Generator) -> None:
    distinct = rng.normal(size=(4, 2))
    chosen = pivoted_cholesky(RBF((1.0,)), np.tile(distinct, (5, 1)), rank=20)
    assert sorted(chosen.pivots % 4) == [0, 1, 2, 3]


def test_the_rank_of_a_polynomial_space_is_found(rng: np.random.Generator) -> None:
    # Cubic polynomials in two variables: 10 monomials.
    assert len(pivoted_cholesky(Polynomial(1.0, 3), rng.normal(size=(60, 2)), rank=60).pivots) == 10


def test_a_kernel_that_vanishes_at_all_points_leaves_an_empty_basis() -> None:
    kernel, x = Polynomial(0.0, 2), np.zeros((3, 2))
    chosen = pivoted_cholesky(kernel, x, rank=3)
    assert chosen.pivots.shape == (0,)
    basis = NewtonBasis.of(kernel, x, chosen)
    assert basis(np.ones((4, 2))).shape == (4, 0)
    assert basis.function(np.empty((0, 3))).weights.shape == (0, 3)
