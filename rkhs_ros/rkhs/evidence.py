r"""Bayesian regression with a linear and a kernel part; the evidence selects the bandwidth and the noise.

.. math:: y = f(x) + \epsilon, \qquad f \sim GP\big(0,\ s^2 (\kappa(x, x') + \tau^2 (1 + x \cdot x'))\big), \qquad
    \epsilon \sim N(0, \lambda s^2)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rkhs_ros.rkhs.kernels import RBF, Array
from rkhs_ros.rkhs.newton import NewtonBasis, pivoted_cholesky

LINEAR_SD = 3.0  # tau: prior sd of the linear coefficients, relative to the kernel part's values
NOISES = np.geomspace(1e-8, 1.0, 25)  # candidates for lambda; the evidence selects one per target
BANDWIDTHS = (1.0, 1.6, 2.5, 4.0, 6.3)
FINE_BANDWIDTHS = (0.4, 0.63, *BANDWIDTHS)  # for functions that may have narrow peaks or kinks
NEWTON_TOLERANCE = 1e-8
LEAST_RESIDUAL = 1e-12  # residuals below this fraction of the targets' square are rounding errors
TINY = 1e-300


class Hyperprior(NamedTuple):
    """The hyper-parameters that a regression may choose.

    Attributes:
        bandwidths: times sqrt(d / 2), the typical distance of points in d dimensions.
        metric_bandwidths: the same for the fits that learn a metric.
        bounded: whether s is at most the range of the targets.
    """

    bandwidths: Sequence[float] = BANDWIDTHS
    metric_bandwidths: Sequence[float] = BANDWIDTHS
    bounded: bool = False


SMOOTH = Hyperprior()


class Coefficients(NamedTuple):
    """The posterior of the coefficients of k functions in p features, along the principal axes of the features.

    Attributes:
        axes: orthonormal axes, shape (p, p).
        mean: posterior mean of the coefficients, shape (p, k).
        sd: posterior standard deviation along each axis, shape (p, k).
        noise: standard deviation of the targets about the functions, shape (k,).
        signal: standard deviation s of the prior, shape (k,).
    """

    axes: Array
    mean: Array
    sd: Array
    noise: Array
    signal: Array


@dataclass(frozen=True)
class Fit:
    """A regression in one basis.

    Attributes:
        basis: basis of the kernel part.
        bandwidth: bandwidth of its kernel.
        evidence: log density of the targets, up to a constant.
        coefficients: posterior of the coefficients.
    """

    basis: NewtonBasis
    bandwidth: float
    evidence: float
    coefficients: Coefficients


def best_fit(
    x: Array,
    targets: Array,
    roots: Array,
    centres: int,
    bandwidths: Sequence[float] = BANDWIDTHS,
    *,
    bounded: bool = False,
) -> Fit:
    """Fit the regression with each bandwidth and return the fit with the greatest evidence.

    Args:
        x: standardised points, shape (points, d).
        targets: standardised targets, shape (points, k).
        roots: square roots of the points' weights, shape (points, 1).
        centres: maximum number of centres of the kernel part.
        bandwidths: see `Hyperprior`.
        bounded: see `Hyperprior`.
    """
    fits = [_fit(bandwidth, x, targets, roots, centres, bounded=bounded) for bandwidth in bandwidths]
    return max(fits, key=lambda fit: fit.evidence)


def _fit(bandwidth: float, x: Array, targets: Array, roots: Array, centres: int, *, bounded: bool) -> Fit:
    kernel = RBF((bandwidth * float(np.sqrt(x.shape[1] / 2.0)),))
    chosen = pivoted_cholesky(kernel, x, centres, NEWTON_TOLERANCE)
    evidence, coefficients = regress(features_of(x, chosen.values), targets, roots, bounded=bounded)
    return Fit(NewtonBasis.of(kernel, x, chosen), kernel.bandwidth[0], evidence, coefficients)


def features_of(x: Array, values: Array) -> Array:
    """Return the constant, linear and kernel features of points, given the values of the kernel features."""
    return np.concatenate([LINEAR_SD * np.ones((len(x), 1)), LINEAR_SD * x, values], axis=1)


def regress(features: Array, targets: Array, roots: Array, *, bounded: bool = False) -> tuple[float, Coefficients]:
    r"""Return the greatest evidence and its posterior; each target has its own noise.

    With the eigenvalues e of :math:`\Phi^\top \Phi` and :math:`c = U^\top \Phi^\top y`,

    .. math:: q = y^\top (\Phi \Phi^\top + \lambda I)^{-1} y
            = \frac1\lambda \Big(y^\top y - \sum_i \frac{c_i^2}{e_i + \lambda}\Big), \qquad
        -2 \log p = n \log s^2 + \frac{q}{s^2} + \sum_i \log(e_i + \lambda) + (n - p) \log \lambda

    at the best :math:`s^2 = q / n` (Rasmussen and Williams, 2006, Eq 5.8), or at its bound.

    Args:
        features: shape (points, p).
        targets: shape (points, k).
        roots: square roots of the points' weights, shape (points, 1); n is the sum of the weights.
        bounded: see `Hyperprior`.
    """
    most_signal = np.maximum(np.ptp(targets, axis=0), 1.0) if bounded else np.inf  # 1: of targets that are all zero
    features, targets = roots * features, roots * targets
    n, p = float(np.sum(roots**2)), features.shape[1]
    values, axes = np.linalg.eigh(features.T @ features)
    values = np.maximum(values, 0.0)[:, None]
    along = axes.T @ (features.T @ targets)
    squares = np.sum(targets**2, axis=0)
    evidences, signals = [], []
    for noise in NOISES:
        explained = np.sum(along**2 / (values + noise), axis=0)
        best_signal = np.maximum(squares - explained, LEAST_RESIDUAL * squares + TINY) / (noise * n)
        signal = np.minimum(best_signal, most_signal**2)
        volume = np.sum(np.log(values + noise)) + (n - p) * np.log(noise)
        evidences.append(-0.5 * (n * np.log(signal) + n * (best_signal / signal - 1.0) + volume))
        signals.append(signal)
    best = np.argmax(evidences, axis=0)
    columns = np.arange(targets.shape[1])
    noise, signal = NOISES[best], np.array(signals)[best, columns]
    sd = np.sqrt(signal * noise / (values + noise))
    mean = axes @ (along / (values + noise))
    total = float(np.array(evidences)[best, columns][squares > 0].sum())  # targets that are all zero carry no evidence
    return total, Coefficients(axes, mean, sd, np.sqrt(signal * noise), np.sqrt(signal))
