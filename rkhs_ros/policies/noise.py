"""Exploration noise with N(0, 1) marginals, uncorrelated (white) or correlated over time (pink)."""

from collections.abc import Callable

import numpy as np

from rkhs_ros.rkhs.kernels import Array

TAPS = 1000  # length of the filter in steps; over longer times the noise is white


def pink(white: Array) -> Array:
    r"""Filter white noise, shape (num_envs, horizon, n), to pink noise, whose power is proportional to 1 / frequency.

    .. math::
        y_t = \frac{\sum_{k=0}^{t} h_k x_{t-k}}{\sqrt{\sum_{k=0}^{t} h_k^2}}, \qquad
        h_0 = 1, \quad h_k = h_{k-1} \frac{k - 1/2}{k}

    with :math:`h_k = 0` from ``TAPS`` on. Each :math:`y_t` is N(0, 1) and depends on no later draw.

    The filter: Kasdin 1995, "Discrete simulation of colored noise and stochastic processes and 1/f power law noise
    generation", Proceedings of the IEEE 83(5). Its use: Eberhard et al. 2023, "Pink noise is all you need: colored
    noise exploration in deep reinforcement learning".
    """
    rows, horizon, dimensions = white.shape
    response = _response(min(horizon, TAPS))
    size = 1 << (horizon + len(response) - 2).bit_length()  # long enough that the end does not wrap around
    transfer = np.fft.rfft(response, size)
    sd = np.sqrt(np.cumsum(response**2))[np.minimum(np.arange(horizon), TAPS - 1)]
    noise = np.empty_like(white)
    for row in range(rows):
        for j in range(dimensions):  # one series at a time saves memory and keeps each series bit-identical
            noise[row, :, j] = np.fft.irfft(transfer * np.fft.rfft(white[row, :, j], size), size)[:horizon] / sd
    return noise


def _response(taps: int) -> Array:
    """Return the impulse response h, shape (taps,)."""
    k = np.arange(1, taps)
    return np.cumprod(np.concatenate([[1.0], (k - 0.5) / k]))


# Filters by name; each maps standard normal draws of shape (num_envs, horizon, n) to noise.
FILTERS: dict[str, Callable[[Array], Array]] = {"white": lambda white: white, "pink": pink}
NOISES = tuple(FILTERS)
