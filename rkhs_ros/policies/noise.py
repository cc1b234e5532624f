"""Exploration noise: how the draws of an episode are correlated over time, each by itself standard normal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rkhs_ros.rkhs.kernels import Array

TAPS = 1000  # steps that a step of pink noise is made of at most; over longer times it is white


def pink(white: Array) -> Array:
    r"""Return noise whose power falls as 1 / frequency, made of white noise, shape (rows, horizon, n).

    .. math::
        y_t = \frac{\sum_{k=0}^{t} h_k x_{t-k}}{\sqrt{\sum_{k=0}^{t} h_k^2}}, \qquad
        h_0 = 1, \quad h_k = h_{k-1} \frac{k - 1/2}{k}

    with :math:`h_k = 0` from ``TAPS`` on. Each :math:`y_t` is N(0, 1) and made of no later draw.

    The filter: Kasdin 1995, "Discrete simulation of colored noise and stochastic processes and 1/f power law noise
    generation", Proceedings of the IEEE 83(5). Its use: Eberhard et al. 2023, "Pink noise is all you need: colored
    noise exploration in deep reinforcement learning".
    """
    rows, horizon, dimensions = white.shape
    response = _response(min(horizon, TAPS))
    size = 1 << (horizon + len(response) - 2).bit_length()  # so long that the end does not come round to the beginning
    transfer = np.fft.rfft(response, size)
    sd = np.sqrt(np.cumsum(response**2))[np.minimum(np.arange(horizon), TAPS - 1)]
    noise = np.empty_like(white)
    for row in range(rows):
        for j in range(dimensions):  # one at a time: no last bit depends on the others, and little memory is taken
            noise[row, :, j] = np.fft.irfft(transfer * np.fft.rfft(white[row, :, j], size), size)[:horizon] / sd
    return noise


def _response(taps: int) -> Array:
    """Return the impulse response h, shape (taps,)."""
    k = np.arange(1, taps)
    return np.cumprod(np.concatenate([[1.0], (k - 0.5) / k]))


# What makes noise of each name of standard normal draws, shape (rows, horizon, n).
FILTERS: dict[str, Callable[[Array], Array]] = {"white": lambda white: white, "pink": pink}
NOISES = tuple(FILTERS)
