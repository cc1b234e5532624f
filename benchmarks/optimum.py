"""Compute the best attainable returns of the tasks, by dynamic programming over a grid of their states.

The formulas of each task give next states and rewards. Values between grid points are interpolated linearly. If two
grids agree, the result does not depend on the grid.
"""

import itertools
import os
import sys
import time

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.sparse import coo_array, csr_array

from command import ended, parser
from sim_nodes.envs import TASKS
from sim_nodes.envs.scene import Array
from sim_nodes.envs.vector_task import VectorTask, clip

DISCOUNT = 0.99

# From rest at distance pi, accelerating halfway with full torque and then braking reaches sqrt(3 pi) = 3.07. The noise
# adds little, so no good policy exceeds 5. Values beyond are those at the edge of the grid.
FASTEST = 5.0

NOTES = {"rkhs/Toy-v0": "aim 14.5", "rkhs/Pendulum-v0": "aim 51.8"}


def quadrature(dimension: int, order: int) -> tuple[Array, Array]:
    """Return nodes, shape (k, dimension), and weights of Gauss-Hermite quadrature over standard normal draws."""
    nodes, weights = hermegauss(order)
    weights = weights / weights.sum()
    grid = np.array(list(itertools.product(nodes, repeat=dimension)))
    return grid, np.array([np.prod(w) for w in itertools.product(weights, repeat=dimension)])


def interpolation(axes: list[Array], points: Array) -> tuple[Array, Array]:
    """Return the flat grid indices and the weights, shape (n, 2^d), of linear interpolation at points, shape (n, d)."""
    indices, weights = np.zeros((len(points), 1), dtype=np.int64), np.ones((len(points), 1))
    for axis, x in zip(axes, points.T, strict=True):
        place = clip((x - axis[0]) / (axis[1] - axis[0]), 0.0, len(axis) - 1.0)
        below = np.minimum(place.astype(np.int64), len(axis) - 2)
        part = (place - below)[:, None]
        indices = len(axis) * indices + below[:, None]
        indices = np.concatenate([indices, indices + 1], axis=1)
        weights = np.concatenate([weights * (1 - part), weights * part], axis=1)
    return indices, weights


def expectation(task: VectorTask, axes: list[Array], states: Array, action: Array, order: int) -> csr_array:
    """Return the matrix from values on the grid to their expectation after an action."""
    actions, shape = np.tile(action, (len(states), 1)), (len(states), len(states))
    total = csr_array(shape)
    nodes, chances = quadrature(task.noise_dim, order)
    for some in np.array_split(np.arange(len(nodes)), -(-len(nodes) // 9)):
        following = [task.transition(states, actions, np.tile(nodes[i], (len(states), 1))) for i in some]
        columns, weights = interpolation(axes, np.concatenate(following))
        weights = weights * np.repeat(chances[some], len(states))[:, None]
        rows = np.broadcast_to(np.tile(np.arange(len(states)), len(some))[:, None], columns.shape)
        total = total + coo_array((weights.ravel(), (rows.ravel(), columns.ravel())), shape).tocsr()
    return total


def optimum(task: VectorTask, horizon: int, axes: list[Array], actions: int, order: int) -> float:
    """Return the best expected return from the initial state.

    Args:
        task: a task with one action dimension.
        horizon: steps of an episode.
        axes: the grid, evenly spaced along each dimension of the state.
        actions: number of actions, evenly spaced over the action space.
        order: quadrature nodes along each dimension of the noise.
    """
    states = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    space = task.single_action_space
    choices = np.linspace(space.low, space.high, actions)
    after = [expectation(task, axes, states, choice, order) for choice in choices]
    rewards = np.array([task.reward(states, np.tile(choice, (len(states), 1))) for choice in choices])
    values = np.zeros(len(states))
    for _ in range(horizon):
        values = np.max([r + DISCOUNT * (e @ values) for r, e in zip(rewards, after, strict=True)], axis=0)
    start, weights = interpolation(axes, task.initial_states(np.zeros((1, task.start_noise_dim))))
    return float(weights[0] @ values[start[0]])


def report(name: str, options: dict[str, str], sizes: tuple[int, ...], actions: int, order: int) -> None:
    """Print the optimum of a task on a grid of these sizes."""
    kind, horizon = TASKS[name]
    task = kind(**options)
    space = task.single_observation_space
    highs = np.minimum(space.high, FASTEST)
    axes = [np.linspace(-high, high, size) for high, size in zip(highs, sizes, strict=True)]
    begin = time.perf_counter()
    best = optimum(task, horizon, axes, actions, order)
    seconds = time.perf_counter() - begin
    label = " ".join([name, *options.values()])
    grid = " x ".join(map(str, sizes))
    print(
        f"{label:<24}{grid:>10} states, {actions} actions  {best:7.2f}  ({NOTES[name]})  {seconds:5.1f} s", flush=True
    )


def main(*, quick: bool) -> None:
    """Print the table."""
    print(f"best return from the start, discount {DISCOUNT}")
    for states in (11,) if quick else (801, 3201):
        report("rkhs/Toy-v0", {}, (states,), 41, 15)
    for angle, sizes in itertools.product(("clip", "wrap"), ((11, 9),) if quick else ((101, 81), (201, 161))):
        report("rkhs/Pendulum-v0", {"angle": angle}, sizes, 13, 3)


if __name__ == "__main__":
    sys.exit(ended(lambda: main(quick=parser(__doc__).parse_args().quick)))
