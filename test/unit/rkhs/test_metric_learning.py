"""The metric stretches directions along which functions change if that increases the evidence."""

from functools import partial

import numpy as np
import pytest

from rkhs_ros.rkhs import metric_learning
from rkhs_ros.rkhs.evidence import best_fit
from rkhs_ros.rkhs.metric_learning import Coordinates, Standardizer, fit_metric, slopes
from rkhs_ros.rkhs.posterior import Posterior

D, N = 8, 150


def along(x: np.ndarray, direction: np.ndarray) -> np.ndarray:
    return np.sin(2.0 * x @ direction)[:, None]


@pytest.fixture
def direction(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=D) / np.sqrt(D)


def test_slopes_match_finite_differences(rng: np.random.Generator) -> None:
    x = rng.normal(size=(60, D))
    y = np.column_stack([np.sin(x[:, 0]) * x[:, 1], x[:, 2] ** 2 + x[:, 3]])
    fit = best_fit(x, y, np.ones((60, 1)), 40)
    units = Standardizer(np.zeros(D), np.ones(D))
    to = Standardizer(np.zeros(2), np.ones(2))
    posterior = Posterior(**vars(fit), points=Coordinates(units), targets=to)
    at, step = rng.normal(size=(5, D)), 1e-5
    found = slopes(fit, at)
    for j, e in enumerate(step * np.eye(D)):
        expected = (posterior.mean(at + e) - posterior.mean(at - e)) / (2 * step)
        np.testing.assert_allclose(found[:, j], expected, atol=1e-6 * np.abs(found).max())


def test_the_metric_finds_the_direction_of_a_ridge_function(rng: np.random.Generator, direction: np.ndarray) -> None:
    x = rng.normal(size=(N, D))
    coordinates, _ = fit_metric(
        Coordinates(Standardizer.of(x)), x, along(x, direction), np.ones((N, 1)), partial(best_fit, centres=100)
    )
    assert coordinates.axes is not None
    squares, axes = np.linalg.eigh(coordinates.axes @ coordinates.axes.T)
    assert squares.sum() == pytest.approx(D)
    assert squares[-1] > 0.95 * D  # the values have no noise; the rest is the error of a finite fit
    cosine = axes[:, -1] @ (direction * Standardizer.of(x).scale)
    assert abs(cosine) > 0.99 * np.linalg.norm(direction * Standardizer.of(x).scale)


def test_the_centred_metric_leaves_a_strong_linear_trend_to_the_linear_part(
    rng: np.random.Generator, direction: np.ndarray
) -> None:
    trend = 10.0 * np.linalg.qr(np.column_stack([direction, rng.normal(size=D)]))[0][:, 1]  # orthogonal
    x, elsewhere = rng.normal(size=(N, D)), rng.normal(size=(300, D))

    def error(*, centred: bool) -> float:
        fitted = Posterior.fit(x, along(x, direction) + x @ trend[:, None], 100, centred=centred)
        truth = along(elsewhere, direction) + elsewhere @ trend[:, None]
        return float(np.sqrt(np.mean((fitted.mean(elsewhere) - truth) ** 2)))

    assert error(centred=True) < 0.5 * error(centred=False)


@pytest.mark.parametrize("seed", range(5))
def test_trying_the_centred_metric_never_lowers_the_evidence(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(80, 4))
    y = np.sin(x[:, :2]) * x[:, 2:] + x[:, :1] + 0.1 * rng.normal(size=(80, 2))
    assert Posterior.fit(x, y, 50, centred=True).evidence >= Posterior.fit(x, y, 50).evidence


@pytest.mark.parametrize("seed", [2, 4, 6])
def test_axes_that_lower_the_evidence_are_rejected(seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(60, 3))
    y, roots, plain = np.sin(2.0 * x).sum(axis=1, keepdims=True), np.ones((60, 1)), Coordinates(Standardizer.of(x))
    coordinates, fit = fit_metric(plain, x, y, roots, partial(best_fit, centres=40))
    assert coordinates == plain
    assert fit.evidence == best_fit(plain.of(x), y, roots, 40).evidence


def test_a_metric_that_some_points_choose_is_fitted_to_all(
    rng: np.random.Generator, direction: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metric_learning, "MOST_FITTED", 60)
    x, roots = rng.normal(size=(N, D)), np.ones((N, 1))
    coordinates, fit = fit_metric(
        Coordinates(Standardizer.of(x)), x, along(x, direction), roots, partial(best_fit, centres=40)
    )
    assert fit.evidence == best_fit(coordinates.of(x), along(x, direction), roots, 40).evidence
