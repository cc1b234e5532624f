r"""Kernel matching pursuit (Vincent and Bengio, 2002): fit many values by a few kernel functions.

The dictionary holds one function :math:`\kappa(c_i, \cdot)` per candidate, represented by its values at the points.
Inner products are computed in a Newton basis of the candidates' span, which avoids the matrix of all points by all
candidates: O((n + p) r^2) time and O((n + p) r) memory for n points, p candidates and a basis of rank r. If the
candidates have a higher rank, the basis represents their projections, which are good enough to select centres but not
to compute weights.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from rkhs_ros.base.validation import require
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel
from rkhs_ros.rkhs.newton import NewtonBasis, pivoted_cholesky
from rkhs_ros.rkhs.regression import blocks_of

LEAST_RANK, RANK_PER_CENTRE = 160, 4  # the Newton basis has at most this size, or, if greater, this times the budget
RANK_TOLERANCE = 1e-13  # squared distance from its span below which the basis spans a candidate
DEPENDENCE_TOLERANCE = 1e-10  # squared distance from the span of the selection, relative to the squared length
SPARSIFICATION_RIDGE = 1e-8
BLOCK_ROWS = 1000  # points whose basis functions are evaluated at once; a block fits into the cache
LEAST_RIDGE = 1e-11  # relative to the sum of the squared coordinates; with less, the normal equations lose digits


@dataclass(frozen=True)
class Pursuit:
    """The result of a matching pursuit.

    Attributes:
        chosen: indices of the selected candidates in the order of selection, shape (m,).
        function: the fitted function on the selected candidates.
        residuals: norm of the targets' residual after 0, 1, ... selections, including a ridge's penalty; it has one
            more entry than there are selections.
    """

    chosen: np.ndarray
    function: Function
    residuals: Array

    @property
    def error(self) -> float:
        """Final residual relative to the targets' norm."""
        return float(self.residuals[-1] / self.residuals[0]) if self.residuals[0] != 0 else 0.0


def pursue(
    kernel: Kernel, points: Array, targets: Array, candidates: Array, *, budget: int, ridge: float = 0.0
) -> Pursuit:
    """Fit values at points by at most ``budget`` kernel functions of the candidates.

    Each selection leaves the smallest residual after all weights are fitted again (pre-fitting).

    Args:
        kernel: scalar kernel.
        points: locations of the targets, shape (n, d).
        targets: values to fit, shape (n, k); all k columns share the selected centres.
        candidates: possible centres, shape (p, d).
        budget: maximum number of selections.
        ridge: weight of the function's squared RKHS norm relative to the mean squared residual.

    Raises:
        ValueError: the budget is below 1.
    """
    require(budget >= 1, "budget", "at least 1 centre", budget)
    rank = max(LEAST_RANK, RANK_PER_CENTRE * budget)
    cholesky = pivoted_cholesky(kernel, candidates, rank, RANK_TOLERANCE)
    basis = NewtonBasis.of(kernel, candidates, cholesky)
    size = len(basis.centres)
    triangle, reduced, unreachable = _reduce(lambda rows: basis(points[rows]), targets, size, ridge * len(points))
    dictionary = triangle @ cholesky.values.T
    chosen, weights, squares = _orthogonal(dictionary, reduced, budget, -unreachable, pre_fitting=True)
    if np.any(cholesky.power[chosen] > cholesky.floor):  # these weights are for projections
        own = candidates[chosen]  # which their own basis spans
        fit = pursue(kernel, points, targets, own, budget=len(own), ridge=ridge)
        return replace(fit, chosen=chosen[fit.chosen])
    residuals = np.sqrt(np.array(squares) + unreachable)
    return Pursuit(chosen, Function(kernel, candidates[chosen], weights), residuals)


def pursue_atoms(
    rows: Array, targets: Array, atoms: Array, *, budget: int, ridge: float = 0.0
) -> tuple[np.ndarray, Array]:
    """Fit targets by combinations of at most ``budget`` atoms.

    Each selection explains most of the residual; then all weights are fitted again (back-fitting).
    The fit of all targets is ``rows @ atoms[chosen].T @ weights``.

    Args:
        rows: coordinates in an orthonormal basis, shape (n, m).
        targets: shape (n, k).
        atoms: candidate vectors in the same coordinates, shape (atoms, m).
        budget: maximum number of selections.
        ridge: weight of the fitted vector's squared norm relative to the mean squared residual.

    Returns:
        The indices of the selected atoms, shape (c,), and their weights, shape (c, k).
    """
    triangle, reduced, unreachable = _reduce(rows.__getitem__, targets, atoms.shape[1], ridge * len(targets))
    chosen, weights, _ = _orthogonal(triangle @ atoms.T, reduced, budget, -unreachable, pre_fitting=False)
    return chosen, weights


def _reduce(rows: Callable[[slice], Array], targets: Array, m: int, ridge: float) -> tuple[Array, Array, float]:
    """Reduce a least-squares problem to one of at most m rows: the factor R, Q'y, and what no function can remove.

    The normal equations take a fraction of the time of a QR factorisation, and with a ridge they are accurate enough.
    """
    n, k = targets.shape
    if ridge > 0.0 and n > m:
        gram, products = np.zeros((m, m)), np.zeros((m, k))
        for block in blocks_of(n, BLOCK_ROWS):
            part = rows(block)
            gram += part.T @ part
            products += part.T @ targets[block]
        if ridge > LEAST_RIDGE * gram.trace():
            factor = cholesky(gram + ridge * np.eye(m), check_finite=False)
            reduced = solve_triangular(factor, products, trans="T", check_finite=False)
            return factor, reduced, max(float(np.sum(targets**2) - np.sum(reduced**2)), 0.0)
    triangle = np.sqrt(ridge) * np.eye(m if ridge > 0.0 else 0, m + k)
    for block in blocks_of(n, BLOCK_ROWS):
        part = np.concatenate([rows(block), targets[block]], axis=1)
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, part]), mode="r"))
    return triangle[:m, :m], triangle[:m, m:], float(np.sum(triangle[m:, m:] ** 2))


class _Columns:
    """Columns of a dictionary, with the part of the residual that each explains; processed in cache-sized blocks."""

    def __init__(self, dictionary: Array, target: Array, *, pre_fitting: bool) -> None:
        self._dictionary = dictionary
        self._blocks = list(blocks_of(dictionary.shape[1]))
        self._lengths = np.einsum("ij,ij->j", dictionary, dictionary)
        self._remaining = self._lengths.copy()  # squared distance of each column from the span of the selection
        self._scale = self._remaining if pre_fitting else self._lengths
        self._products = target.T @ dictionary  # with the residual
        self._gains = np.empty(dictionary.shape[1])

    def best(self) -> tuple[int, float]:
        """Return the column that explains most of the residual, and how much it explains."""
        for block in self._blocks:
            independent = self._remaining[block] > DEPENDENCE_TOLERANCE * self._lengths[block]
            scale = np.where(independent, self._scale[block], np.inf)
            self._gains[block] = np.sum(self._products[:, block] ** 2, axis=0) / scale
        best = int(self._gains.argmax())
        return best, float(self._gains[best])

    def choose(self, chosen: int, unit: Array, weight: Array) -> None:
        """Update the columns after a column is selected.

        Args:
            chosen: index of the selected column.
            unit: unit vector that this column adds to the span of the selection.
            weight: components of the residual along the unit vector, which the selection now explains.
        """
        for block in self._blocks:
            shares = unit @ self._dictionary[:, block]
            self._products[:, block] -= np.outer(weight, shares)
            self._remaining[block] = np.maximum(self._remaining[block] - shares**2, 0.0)
        self._remaining[chosen] = 0.0


def _orthogonal(
    dictionary: Array, target: Array, budget: int, floor: float, *, pre_fitting: bool
) -> tuple[np.ndarray, Array, list[float]]:
    """Select columns and refit all weights by extending a QR factorisation of the selection."""
    columns, residual = _Columns(dictionary, target, pre_fitting=pre_fitting), target.copy()
    budget = min(budget, *dictionary.shape)
    frame = np.empty((budget, len(dictionary)))
    triangle = np.zeros((budget, budget))
    chosen: list[int] = []
    squares = [float(np.sum(residual**2))]
    while len(chosen) < budget and squares[-1] > floor:
        best, gain = columns.best()
        if gain <= 0.0:
            break
        k = len(chosen)
        frame[k], triangle[:k, k], triangle[k, k] = _orthogonalise(dictionary[:, best], frame[:k])
        chosen.append(best)
        weight = frame[k] @ residual
        residual -= np.outer(frame[k], weight)
        columns.choose(best, frame[k], weight)
        squares.append(float(np.sum(residual**2)))
    k = len(chosen)
    if k == 0:
        return np.empty(0, dtype=int), np.empty((0, target.shape[1])), squares
    weights = solve_triangular(triangle[:k, :k], frame[:k] @ target, check_finite=False)
    return np.array(chosen, dtype=int), np.asarray(weights), squares


def _orthogonalise(column: Array, frame: Array) -> tuple[Array, Array, float]:
    """Split a column into a part in the span of the frame's rows and a part orthogonal to them.

    Returns the unit vector of the orthogonal part, the coordinates of the first part, and the length of the orthogonal
    part. Gram-Schmidt runs twice, because a single pass loses digits.
    """
    first = frame @ column
    rest = column - first @ frame
    second = frame @ rest
    rest -= second @ frame
    length = float(np.linalg.norm(rest))
    return rest / length, first + second, length


def sparsify(function: Function, points: Array, *, budget: int) -> Pursuit:
    """Approximate a function at the points by a subset of its centres, and keep its bias.

    Args:
        function: the function to sparsify.
        points: points at which its values are fitted, shape (n, d).
        budget: maximum number of centres.
    """
    values = replace(function, bias=())(points)
    fit = pursue(function.kernel, points, values, function.centres, budget=budget, ridge=SPARSIFICATION_RIDGE)
    return replace(fit, function=replace(fit.function, bias=function.bias))
