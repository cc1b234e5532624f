"""The variance update of PoWER: Eq 24, corrected and as published."""

from collections.abc import Callable

import numpy as np

from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.variance import FunctionVariance, KernelVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.pursuit import sparsify
from rkhs_ros.rkhs.regression import by_blocks

LEAST_MASS = 1e-9  # centres with a smaller mass relative to the largest are removed


def learnt(samples: Samples, weights: Array, sd_minimum: float, sd_maximum: float) -> KernelVariance:
    r"""Return the kernel-weighted mean of squared exploration, with each sample assigned to its nearest centre.

    .. math:: g(s) = \frac{\sum_t q_t \epsilon_t^2 \kappa(s_t, s)}{\sum_t q_t \kappa(s_t, s)}

    Args:
        samples: samples of the iteration.
        weights: q, shape (samples,), not negative.
        sd_minimum: minimum standard deviation.
        sd_maximum: maximum standard deviation.
    """
    weights = np.maximum(weights, 0.0) if (weights > 0).any() else np.ones_like(weights)
    kernel, centres = samples.basis.kernel, samples.basis.centres
    points = samples.observations
    nearest = by_blocks(lambda rows: kernel(points[rows], centres).argmax(axis=1), len(points))
    mass = np.bincount(nearest, weights, len(centres))
    squares = (weights[:, None] * samples.exploration**2).T
    sums = np.stack([np.bincount(nearest, column, len(centres)) for column in squares], axis=1)
    used = mass > LEAST_MASS * mass.max()
    low, high = _bounds(samples, sd_minimum, sd_maximum)
    return KernelVariance(kernel, centres[used], mass[used], sums[used] / mass[used, None], low, high)


def as_published(samples: Samples, weights: Array, sd_minimum: float, sd_maximum: float) -> FunctionVariance:
    r"""Return the function of Eq 24 as published, with as many centres as the basis.

    .. math:: g(s) = \sum_t \kappa(s_t, s)\,\beta_t, \qquad
        \beta_t = \frac{\epsilon_t^2 A_t}{\kappa(s_t, s_t) \sum_k \epsilon_k^2 A_k}

    Squared exploration occurs in numerator and denominator and cancels, so the value is not related to its size.
    """
    kernel = samples.basis.kernel
    squares = weights[:, None] * samples.exploration**2
    shares = squares / np.where(squares.sum(axis=0) == 0, 1.0, squares.sum(axis=0))
    beta = shares / np.maximum(kernel.diagonal(samples.observations), np.finfo(float).tiny)[:, None]
    whole = Function(kernel, samples.observations, beta)
    thinned = sparsify(whole, samples.observations, budget=len(samples.basis.centres)).function
    return FunctionVariance(thinned, *_bounds(samples, sd_minimum, sd_maximum))


def _bounds(samples: Samples, sd_minimum: float, sd_maximum: float) -> tuple[Array, Array]:
    ones = np.ones(samples.exploration.shape[1])
    return sd_minimum**2 * ones, sd_maximum**2 * ones


Learnt = Callable[[Samples, Array, float, float], Variance]
VARIANCES: dict[str, Learnt] = {"learnt": learnt, "as_published": as_published}
