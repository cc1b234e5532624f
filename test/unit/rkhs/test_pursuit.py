import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sklearn.linear_model import OrthogonalMatchingPursuit

from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial, median_bandwidth
from rkhs_ros.rkhs.pursuit import SPARSIFICATION_RIDGE, pursue, pursue_atoms, sparsify
from test.unit.conftest import inner

KERNEL = RBF((0.5,))


def problem(seed: int, n: int = 60, p: int = 25, columns: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points, candidates = rng.uniform(-2, 2, (n, 2)), rng.uniform(-2, 2, (p, 2))
    return points, rng.normal(size=(n, columns)), candidates


@given(seed=st.integers(0, 10_000))
def test_pre_fitting_minimises_the_residual_after_the_refit(seed: int) -> None:
    points, targets, candidates = problem(seed, columns=2)
    fit = pursue(KERNEL, points, targets, candidates, budget=4)
    dictionary = KERNEL(points, candidates)
    for k in range(4):
        left = [
            np.linalg.norm(targets - columns @ np.linalg.lstsq(columns, targets)[0])
            for columns in (dictionary[:, [*fit.chosen[:k], j]] for j in range(len(candidates)))
        ]
        assert fit.residuals[k + 1] == pytest.approx(min(left), rel=1e-6)


def test_selecting_all_candidates_gives_ridge_regression() -> None:
    points, targets, candidates = problem(3, n=40, p=12, columns=2)
    fit = pursue(KERNEL, points, targets, candidates, budget=12, ridge=0.1)
    design, gram = KERNEL(points, candidates), KERNEL(candidates, candidates)
    weights = np.linalg.solve(design.T @ design + 0.1 * 40 * gram, design.T @ targets)
    np.testing.assert_allclose(fit.function.weights, weights[fit.chosen], rtol=1e-6)
    penalised = np.sum((targets - design @ weights) ** 2) + 0.1 * 40 * np.sum(weights * (gram @ weights))
    assert fit.residuals[-1] ** 2 == pytest.approx(penalised, rel=1e-8)


@given(
    seed=st.integers(0, 10_000),
    d=st.integers(5, 12),
    budget=st.integers(1, 50),
    ridge=st.sampled_from([0.0, 1e-6, 1e-3]),
)
@settings(max_examples=30)
def test_a_truncated_basis_only_selects(seed: int, d: int, budget: int, ridge: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(300, d))  # of higher rank than the basis
    kernel, targets = RBF(median_bandwidth(points)), np.tanh(points @ rng.normal(size=(d, 2)))
    fit = pursue(kernel, points, targets, points, budget=budget, ridge=ridge)
    centres, gram = fit.function.centres, kernel(fit.function.centres, fit.function.centres)
    assert np.array_equal(centres, points[fit.chosen])

    def squares(weights: np.ndarray) -> float:
        errors = targets - kernel(points, centres) @ weights
        return float(np.sum(errors**2) + ridge * len(points) * np.sum(weights * (gram @ weights)))

    design = np.concatenate([kernel(points, centres), np.sqrt(ridge * len(points)) * np.linalg.cholesky(gram).T])
    best = np.linalg.lstsq(design, np.concatenate([targets, np.zeros((len(centres), 2))]))[0]
    assert fit.residuals[-1] ** 2 == pytest.approx(squares(fit.function.weights), rel=1e-9)
    assert squares(fit.function.weights) == pytest.approx(squares(best), rel=1e-9)
    assert np.all(np.diff(fit.residuals) <= 0)
    assert fit.residuals[0] == pytest.approx(np.linalg.norm(targets))
    assert fit.error == pytest.approx(fit.residuals[-1] / fit.residuals[0])


def test_dependent_candidates_are_skipped(rng: np.random.Generator) -> None:
    kernel: Kernel = Polynomial(1.0, 1)  # spans 1, x, y: at most three independent functions
    points, candidates = rng.normal(size=(30, 2)), rng.normal(size=(10, 2))
    fit = pursue(kernel, points, rng.normal(size=(30, 1)), candidates, budget=10)
    assert len(fit.chosen) == 3
    assert np.isfinite(fit.function.weights).all()


def test_nearly_repeated_candidates_are_skipped() -> None:
    points, targets, candidates = problem(10, p=5)
    pairs = np.concatenate([candidates, candidates + 1e-6])
    fit = pursue(KERNEL, points, targets, pairs, budget=10)
    assert sorted(fit.chosen % 5) == [0, 1, 2, 3, 4]
    assert (
        np.abs(fit.function.weights).max() < 100
    )  # the difference of two such candidates would need weights of about 1e5


def test_zero_targets_select_nothing() -> None:
    points, targets, candidates = problem(8, columns=2)
    fit = pursue(KERNEL, points, 0 * targets, candidates, budget=5)
    assert (len(fit.chosen), fit.function.weights.shape, fit.error) == (0, (0, 2), 0.0)


@given(seed=st.integers(0, 10_000), m=st.integers(1, 12))
def test_a_budget_for_all_centres_preserves_the_function(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    function = Function(KERNEL, rng.uniform(-2, 2, (m, 2)), rng.normal(size=(m, 2)))
    points = rng.uniform(-2, 2, (50, 2))
    fit = sparsify(function, points, budget=m)
    np.testing.assert_allclose(fit.function(points), function(points), atol=1e-5)
    penalty = np.sqrt(SPARSIFICATION_RIDGE * len(points)) * np.sqrt(
        inner(function, function)
    )  # the function's own penalty
    assert fit.error <= penalty / np.linalg.norm(function(points)) * (1 + 1e-6)


@given(seed=st.integers(0, 10_000), columns=st.integers(1, 2))
def test_the_pursuit_of_atoms_matches_scikit_learn_and_selects_the_best_atom_in_each_step(
    seed: int, columns: int
) -> None:
    rng = np.random.default_rng(seed)
    rows, atoms, targets = rng.normal(size=(60, 12)), rng.normal(size=(25, 12)), rng.normal(size=(60, columns))
    chosen, weights = pursue_atoms(rows, targets, atoms, budget=6)
    dictionary = rows @ atoms.T
    lengths = np.linalg.norm(dictionary, axis=0)
    assert weights.shape == (6, columns)
    if columns == 1:
        oracle = OrthogonalMatchingPursuit(n_nonzero_coefs=6, fit_intercept=False).fit(
            dictionary / lengths, targets[:, 0]
        )
        assert set(chosen) == set(np.flatnonzero(oracle.coef_))
        np.testing.assert_allclose(weights[:, 0], (oracle.coef_ / lengths)[chosen], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(weights, np.linalg.lstsq(dictionary[:, chosen], targets)[0], rtol=1e-8, atol=1e-10)
    for k, choice in enumerate(chosen):
        fitted = dictionary[:, chosen[:k]]
        left = targets - fitted @ np.linalg.lstsq(fitted, targets)[0]
        assert choice == np.argmax(np.sum((dictionary.T @ left) ** 2, axis=1) / lengths**2)


@pytest.mark.parametrize("n", [60, 7], ids=["tall", "wide"])
def test_the_ridge_of_a_pursuit_of_atoms_penalises_the_fitted_vector(n: int, rng: np.random.Generator) -> None:
    rows, atoms, targets = rng.normal(size=(n, 5)), rng.normal(size=(9, 5)), rng.normal(size=(n, 2))
    chosen, weights = pursue_atoms(rows, targets, atoms, budget=9, ridge=0.3)
    vector = np.linalg.solve(rows.T @ rows + 0.3 * n * np.eye(5), rows.T @ targets)  # five atoms span all vectors
    assert len(chosen) == 5
    np.testing.assert_allclose(atoms[chosen].T @ weights, vector, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(("candidates", "columns", "ridge"), [(1, 1, 0.0), (12, 2, 0.0), (12, 2, 1e-3), (90, 2, 1e-8)])
def test_fitting_in_blocks_matches_fitting_all_points_at_once(
    candidates: int, columns: int, ridge: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, targets, chosen_among = problem(3, n=700, p=candidates, columns=columns)
    whole = pursue(KERNEL, points, targets, chosen_among, budget=9, ridge=ridge)
    monkeypatch.setattr("rkhs_ros.rkhs.pursuit.BLOCK_ROWS", 50)
    parts = pursue(KERNEL, points, targets, chosen_among, budget=9, ridge=ridge)
    assert parts.chosen.tolist() == whole.chosen.tolist()
    np.testing.assert_allclose(parts.residuals, whole.residuals, rtol=1e-11)
    np.testing.assert_allclose(parts.function.weights, whole.function.weights, rtol=1e-7)


@pytest.mark.parametrize("ridge", [1e-8, 1e-3])
def test_normal_equations_match_a_qr_factorisation(ridge: float, monkeypatch: pytest.MonkeyPatch) -> None:
    points, targets, candidates = problem(5, n=700, p=160, columns=2)
    fast = pursue(KERNEL, points, targets, candidates, budget=40, ridge=ridge)
    monkeypatch.setattr("rkhs_ros.rkhs.pursuit.LEAST_RIDGE", np.inf)
    exact = pursue(KERNEL, points, targets, candidates, budget=40, ridge=ridge)
    assert fast.chosen.tolist() == exact.chosen.tolist()
    np.testing.assert_allclose(fast.residuals, exact.residuals, rtol=1e-9)
    np.testing.assert_allclose(fast.function(points), exact.function(points), atol=1e-8)


@pytest.mark.parametrize("rows", [0, 1, 2, 3])
def test_underdetermined_problems_are_solved_exactly(rows: int, rng: np.random.Generator) -> None:
    equations, targets = rng.normal(size=(rows, 3)), rng.normal(size=(rows, 1))
    chosen, weights = pursue_atoms(equations, targets, np.eye(3), budget=3)
    np.testing.assert_allclose(equations[:, chosen] @ weights, targets, atol=1e-9)
