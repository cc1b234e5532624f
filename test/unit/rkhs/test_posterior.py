"""The posterior matches scikit-learn's Gaussian process and does not depend on units."""

import json
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel

from rkhs_ros.rkhs import metric_learning
from rkhs_ros.rkhs.evidence import BANDWIDTHS, LINEAR_SD, Hyperprior, features_of, regress
from rkhs_ros.rkhs.posterior import Posterior, spread_points

N, D = 200, 5
FULL = BANDWIDTHS[:3]  # with these, all points of the tests become centres
FitWith = Callable[..., Posterior]


def only(bandwidth: float) -> Hyperprior:
    return Hyperprior((bandwidth,), (bandwidth,))


def points_of(rng: np.random.Generator, n: int = N) -> np.ndarray:
    return 5.0 + rng.normal(size=(n, D)) * np.geomspace(0.3, 3.0, D)


def targets_of(rng: np.random.Generator, x: np.ndarray, columns: int = 1) -> np.ndarray:
    clean = np.sin(np.arange(1, columns + 1) * x[:, :1]) + 2.0 * (x[:, 1:2] - 5.0) ** 2 + 0.1 * x[:, 2:3]
    return 100.0 + clean + 0.3 * rng.normal(size=clean.shape)


def oracle(fitted: Posterior, x: np.ndarray, y: np.ndarray, column: int = 0) -> GaussianProcessRegressor:
    """Return scikit-learn's process for a standardised target with the selected hyper-parameters."""
    signal, noise = (float(values[column]) ** 2 for values in (fitted.coefficients.signal, fitted.coefficients.noise))
    kernel = (
        ConstantKernel(signal) * RBF(fitted.basis.kernel.terms()[0].parameters[0])
        + ConstantKernel(signal * LINEAR_SD**2) * DotProduct(sigma_0=1.0)
        + WhiteKernel(noise)
    )
    process = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None)
    return process.fit(fitted.points.of(x), fitted.targets.standardise(y)[:, column])


def predicted(
    process: GaussianProcessRegressor, fitted: Posterior, x: np.ndarray, column: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of the function without noise, in the target's units."""
    mean, covariance = process.predict(fitted.points.of(x), return_cov=True)
    scale = fitted.targets.scale[column]
    without_noise = covariance - np.eye(len(x)) * fitted.coefficients.noise[column] ** 2
    return fitted.targets.centre[column] + scale * mean, scale**2 * without_noise


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable metric learning, because a learnt metric may need fewer centres than points."""
    monkeypatch.setattr(metric_learning, "ROUNDS", 0)


@pytest.fixture
def fit_with(plain: None) -> FitWith:
    """Fit with one bandwidth and all points as centres."""
    return lambda bandwidth, x, y: Posterior.fit(x, y, len(x), hyperprior=only(bandwidth))


@pytest.mark.parametrize("bandwidth", [FULL[0], FULL[-1]])
def test_with_all_points_as_centres_it_matches_scikit_learn(
    fit_with: FitWith, rng: np.random.Generator, bandwidth: float
) -> None:
    x, elsewhere = points_of(rng), points_of(rng, 100)
    y = targets_of(rng, x, 2)
    fitted = fit_with(bandwidth, x, y)
    assert len(fitted.basis.centres) == N
    for column in range(2):
        mean, covariance = predicted(oracle(fitted, x, y, column), fitted, elsewhere, column)
        np.testing.assert_allclose(fitted.mean(elsewhere)[:, column], mean, rtol=1e-8)
        np.testing.assert_allclose(fitted.sd(elsewhere)[:, column], np.sqrt(np.diag(covariance)), rtol=1e-6)


def test_with_a_learnt_metric_it_matches_scikit_learn(rng: np.random.Generator) -> None:
    x, elsewhere = points_of(rng), points_of(rng, 100)
    y = targets_of(rng, x)
    fitted = Posterior.fit(x, y, len(x), hyperprior=only(0.25))
    assert fitted.points.axes is not None
    assert len(fitted.basis.centres) == N
    mean, covariance = predicted(oracle(fitted, x, y), fitted, elsewhere)
    np.testing.assert_allclose(fitted.mean(elsewhere)[:, 0], mean, rtol=1e-6)
    np.testing.assert_allclose(fitted.sd(elsewhere)[:, 0], np.sqrt(np.diag(covariance)), rtol=1e-2)


def test_the_evidence_matches_scikit_learn_up_to_a_constant(fit_with: FitWith, rng: np.random.Generator) -> None:
    x = points_of(rng)
    y = targets_of(rng, x)
    differences = []
    for bandwidth in FULL:
        fitted = fit_with(bandwidth, x, y)
        features, targets = fitted.features(x), fitted.targets.standardise(y)
        ours = regress(features, targets, np.ones((len(features), 1)))[0]
        differences.append(oracle(fitted, x, y).log_marginal_likelihood_value_ - ours)
    # At the best signal the quadratic form of the density is n.
    np.testing.assert_allclose(differences, -0.5 * N * (1.0 + np.log(2.0 * np.pi)), rtol=1e-9)


def test_a_bounded_function_is_as_likely_as_the_density_says_at_the_bound() -> None:
    x = np.linspace(-1.0, 1.0, 30)[:, None]
    features, y = features_of(x, np.linalg.cholesky(RBF(2.0)(x) + 1e-9 * np.eye(30))), 4.0 * np.abs(x)
    for bounded in (False, True):
        evidence, found = regress(features, y, np.ones((30, 1)), bounded=bounded)
        assert found.signal == np.ptp(y) if bounded else found.signal > 10.0 * np.ptp(y)  # for the kink
        covariance = found.signal**2 * features @ features.T + found.noise**2 * np.eye(30)
        density = multivariate_normal(cov=covariance).logpdf(y[:, 0])
        assert density - evidence == pytest.approx(-15.0 * (1.0 + np.log(2.0 * np.pi)), abs=1e-4)


def test_bandwidth_and_noise_maximise_the_evidence(fit_with: FitWith, rng: np.random.Generator) -> None:
    x = points_of(rng)
    y = targets_of(rng, x)
    chosen = oracle(Posterior.fit(x, y, N), x, y)
    others = [oracle(fit_with(bandwidth, x, y), x, y) for bandwidth in BANDWIDTHS]
    best = max(other.log_marginal_likelihood_value_ for other in others)
    assert chosen.log_marginal_likelihood_value_ == pytest.approx(best, abs=1e-6)
    noise = chosen.kernel_.theta[-1]
    for factor in (0.4, 2.5):  # adjacent candidates differ by a factor of 2.15
        worse = chosen.log_marginal_likelihood([*chosen.kernel_.theta[:-1], noise + np.log(factor)])
        assert worse < chosen.log_marginal_likelihood_value_


def test_draws_have_the_mean_and_covariance_of_the_posterior(fit_with: FitWith, rng: np.random.Generator) -> None:
    x, rows = points_of(rng), 4000
    y = targets_of(rng, x)
    fitted = fit_with(FULL[-1], x, y)
    drawn = fitted.draw(rng.standard_normal((rows, *fitted.draw_shape)))
    at = x[:8]  # in the span of the centres
    values = drawn.along(at[None])[:, :, 0]
    mean, covariance = predicted(oracle(fitted, x, y), fitted, at)
    sd = np.sqrt(np.diag(covariance))
    # Margins of 4.5 standard errors: one in 3000 draws of 8 means and 36 covariances exceeds them.
    np.testing.assert_allclose((values.mean(axis=0) - mean) / sd, 0.0, atol=4.5 / np.sqrt(rows))
    correlation = covariance / np.outer(sd, sd)
    found = np.cov(values.T) / np.outer(sd, sd)
    assert (np.abs(found - correlation) < 4.5 * np.sqrt((1.0 + correlation**2) / rows)).all()


@pytest.mark.parametrize("centres", [3, 30])
def test_draws_spread_as_far_as_the_standard_deviation_says(rng: np.random.Generator, centres: int) -> None:
    x, draws = points_of(rng), 1000
    fitted = Posterior.fit(x, targets_of(rng, x, 2), centres)
    far = 5.0 + 3.0 * (points_of(rng, 100) - 5.0)
    at = np.concatenate([points_of(rng, 100), far])
    drawn = fitted.draw(rng.standard_normal((draws, *fitted.draw_shape)))
    spread = np.std(drawn.along(at[None]), axis=0)
    ratios = spread / fitted.sd(at)
    # A finite number of waves represents the kernel approximately, best where they matter: outside the span.
    assert ratios.min() > 0.5
    assert ratios.max() < 1.5
    assert np.median(ratios) == pytest.approx(1.0, abs=0.1)
    assert np.median(ratios[100:]) == pytest.approx(1.0, abs=0.1)


def test_the_part_of_a_draw_outside_the_span_vanishes_at_the_centres(rng: np.random.Generator) -> None:
    x = points_of(rng)
    fitted = Posterior.fit(x, targets_of(rng, x, 2), 30)
    normals = rng.standard_normal((1, *fitted.draw_shape))
    normals[:, :, : len(fitted.coefficients.mean)] = 0.0
    drawn = fitted.draw(normals)
    is_centre = (fitted.points.of(x)[:, None] == fitted.basis.centres).all(axis=2).any(axis=1)
    off = np.abs(drawn.along(x[None])[0] - fitted.mean(x)) / fitted.targets.scale
    assert is_centre.sum() == 30
    assert off[is_centre].max() < 1e-6
    assert np.median(off[~is_centre]) > 1e-3


INTERRUPTED = """
import signal, sys
from rkhs_ros.rkhs.posterior import spread_points
is_numbers = lambda event, values: event == "open" and "direction_numbers" in str(values[0])
sys.addaudithook(lambda *its: signal.raise_signal(signal.SIGINT) if is_numbers(*its) else None)
try:
    spread_points(8, 3, seed=0)
except KeyboardInterrupt:
    print(spread_points(8, 3, seed=0).tolist())
"""


def test_ctrl_c_while_a_sequence_is_initialised_is_not_lost() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True)  # once per process
    assert done.stderr == ""
    assert json.loads(done.stdout) == spread_points(8, 3, seed=0).tolist()


@pytest.mark.parametrize("centres", [1, 20])
def test_a_draw_of_zeros_is_the_posterior_mean(rng: np.random.Generator, centres: int) -> None:
    x = points_of(rng)
    fitted = Posterior.fit(x, targets_of(rng, x, 3), centres)
    drawn = fitted.draw(np.zeros((len(x), *fitted.draw_shape)))
    np.testing.assert_allclose(drawn(x), fitted.mean(x), rtol=1e-9)
    np.testing.assert_allclose(drawn.along(x[None])[3], fitted.mean(x), rtol=1e-9)


def test_far_from_all_points_the_kernel_part_has_its_prior_uncertainty(
    fit_with: FitWith, rng: np.random.Generator
) -> None:
    x = points_of(rng)
    y = targets_of(rng, x)
    fitted = fit_with(FULL[-1], x, y)
    far = points_of(rng, 20) + 100.0
    np.testing.assert_allclose(fitted.basis(fitted.points.of(far)), 0.0, atol=1e-12)
    _, covariance = predicted(oracle(fitted, x, y), fitted, far)
    np.testing.assert_allclose(fitted.sd(far)[:, 0], np.sqrt(np.diag(covariance)), rtol=0.01)
    few = Posterior.fit(x, y, 5)
    for posterior in (fitted, few):
        prior = posterior.coefficients.signal * posterior.targets.scale
        assert (posterior.sd(far) >= prior).all()


def test_weights_act_as_repeated_points(plain: None, rng: np.random.Generator) -> None:
    x, elsewhere = points_of(rng, 60), points_of(rng)
    y, times = targets_of(rng, x, 2), rng.integers(1, 4, len(x))
    weighted = Posterior.fit(x, y, 30, times.astype(float))
    repeated = Posterior.fit(np.repeat(x, times, axis=0), np.repeat(y, times, axis=0), 30)
    np.testing.assert_allclose(weighted.mean(elsewhere), repeated.mean(elsewhere), rtol=1e-8)
    np.testing.assert_allclose(weighted.sd(elsewhere), repeated.sd(elsewhere), rtol=1e-6)
    np.testing.assert_allclose(weighted.noise, repeated.noise, rtol=1e-8)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [0.0, -1e8 / 3])
def test_constant_columns_change_nothing(rng: np.random.Generator, value: float) -> None:
    x = points_of(rng, 100)
    y = targets_of(rng, x)
    still = np.column_stack([x, np.full(len(x), value)])
    fitted = Posterior.fit(still, y, 50)
    assert fitted.points.units.scale[-1] == 1.0
    process = oracle(fitted, still, y)
    mean, covariance = predicted(process, fitted, still)
    np.testing.assert_allclose(fitted.mean(still)[:, 0], mean, atol=0.3)  # half of the hundred points are centres
    assert np.isfinite(fitted.sd(still)).all()
    assert (fitted.sd(still)[:, 0] < 2.0 * np.sqrt(np.diag(covariance))).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [0.0, -1e8 / 3])
def test_constant_targets_are_predicted_without_uncertainty(rng: np.random.Generator, value: float) -> None:
    x, still = points_of(rng, 100), np.full((100, 40), value)
    y = targets_of(rng, x)
    fitted, alone = Posterior.fit(x, np.column_stack([still, y]), 50), Posterior.fit(x, y, 50)
    drawn = fitted.draw(rng.standard_normal((3, *fitted.draw_shape)))
    margin = 1e-9 * abs(value) + 1e-99
    np.testing.assert_allclose(fitted.mean(x)[:, :40], value, atol=margin)
    np.testing.assert_allclose(drawn.along(x[None])[0, :, :40], value, atol=margin)
    assert (fitted.sd(x)[:, :40] <= margin).all()
    np.testing.assert_allclose(fitted.mean(x)[:, 40:], alone.mean(x), rtol=1e-12)  # they do not affect the bandwidth


@pytest.mark.filterwarnings("error")
def test_the_mean_of_a_single_point_is_its_value_everywhere(rng: np.random.Generator) -> None:
    fitted = Posterior.fit(points_of(rng, 1), np.array([[3.0, -1.0]]), 10)
    x = points_of(rng, 20)
    np.testing.assert_allclose(fitted.mean(x), np.tile([3.0, -1.0], (20, 1)))
    assert np.isfinite(fitted.sd(x)).all()
    assert np.isfinite(fitted.draw(rng.standard_normal((20, *fitted.draw_shape)))(x)).all()
