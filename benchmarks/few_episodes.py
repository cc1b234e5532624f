"""How few episodes RKHS-NAC learns in, beside CMA-ES on the weights of a policy with fixed centres.

Counted are episodes until the noise-free return, the mean of 10 episodes after an update, first passes a threshold.
CMA-ES judges each candidate by one noise-free episode, which counts. After each generation the mean of its
distribution is evaluated as RKHS-NAC's policy is, which does not count. Three first standard deviations of the
weights are tried; 2 on the pendulum and 0.25 on the toy task end best.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from cmaes import CMA
from joblib import Parallel, delayed

import sim_nodes.envs  # noqa: F401  # registers the tasks
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.fixed import grid
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.simulation import Simulation

CONFIGS = Path(__file__).parents[1] / "config"
SEEDS = range(20)
EPISODES, EVALUATION = 300, 10
NOISE_FREE = ConstantVariance(np.array([1e-18]))  # all but

Curve = tuple[Array, Array]  # episodes used, and noise-free return, after each update


class Task(NamedTuple):
    """What is to be reached, with which configuration, and the centres and bandwidths that CMA-ES is given."""

    config: str
    thresholds: tuple[float, ...]
    aims: str
    centres: Array
    kernel: RBF


ON_PENDULUM = grid(np.array([-3.2, -4.0]), np.array([3.2, 4.0]), (8, 5)), RBF((0.8, 1.6))
ON_TOY = grid(np.array([-4.0]), np.array([4.0]), (20,)), RBF((0.7,))
PENDULUM = Task("pendulum_few_nac", (45.0, 50.0), "20 / 40     40 / 80     50 / 51.2", *ON_PENDULUM)
WRAP = Task("pendulum_wrap_few_nac", (45.0, 50.0), "30 / 70", *ON_PENDULUM)
TOY = Task("toy_few_nac", (14.0, 14.2), "25 / -", *ON_TOY)


def setting(task: Task, seed: int) -> tuple[Config, InlineRunner]:
    """Return the configuration of a run and what its policies act in."""
    config = load_config(CONFIGS / f"{task.config}.yaml", [f"seed={seed}", f"evaluation_episodes={EVALUATION}"])
    return config, InlineRunner(Simulation(config.environment.id, config.environment.options))


def rkhs_nac(task: Task, seed: int) -> Curve:
    """Learn by the configuration."""
    config, runner = setting(task, seed)
    points = [(i.episodes_used, i.mean_policy_returns.mean()) for i in train(config.training, runner)]
    episodes, returns = np.array(points, dtype=float).T
    return episodes, returns


def cma_es(task: Task, seed: int, sd: float) -> Curve:
    """Search the weights, at first of mean 0 and that standard deviation, with the package's population."""
    score = scorer(task, seed)
    search = CMA(np.zeros(len(task.centres)), sd, seed=seed)
    points: list[tuple[int, float]] = []
    for used in range(0, EPISODES, search.population_size):
        candidates = [search.ask() for _ in range(search.population_size)]
        # Of a batch that explores, so that the evaluation's episodes are others.
        search.tell([(x, -score(x, used + i, 1, explore=True)) for i, x in enumerate(candidates)])
        evaluated = score(search.mean, len(points) * EVALUATION, EVALUATION, explore=False)
        points.append((used + len(candidates), evaluated))
    episodes, returns = np.array(points, dtype=float).T
    return episodes, returns


def scorer(task: Task, seed: int) -> Callable[..., float]:
    """Return what gives weights their mean return in a number of episodes from a first one on."""
    config, runner = setting(task, seed)
    horizon, discount = config.task.horizon, config.task.discount

    def score(weights: Array, first: int, rows: int, *, explore: bool) -> float:
        policy = GaussianPolicy(Function(task.kernel, task.centres, weights[:, None]), NOISE_FREE)
        episodes = runner.collect(policy, Batch(seed, first, rows, horizon, explore=explore))
        return float(episodes.returns(discount).mean())

    return score


def first_above(curve: Curve, threshold: float) -> float:
    """Return the episodes used when the return first passed the threshold; infinity where it never did."""
    episodes, returns = curve
    return float(min(episodes[returns > threshold], default=np.inf))


def report(name: str, task: Task, learn: Callable[[Task, int], Curve], aims: str = "") -> None:
    """Print what came of all seeds."""
    curves: list[Curve] = Parallel(n_jobs=-1)(delayed(learn)(task, seed) for seed in SEEDS)
    needed = np.array([[first_above(curve, threshold) for curve in curves] for threshold in task.thresholds])
    ends = np.array([returns[-1] for _, returns in curves])
    above, median, worst = (
        " / ".join(f"{x:g}" for x in values) for values in (task.thresholds, np.median(needed, 1), needed.max(1))
    )
    end = f"{ends.min():.2f} / {ends.mean():.2f} ({curves[0][0][-1]:.0f})"
    print(f"{name:<32}{above:<12}{median:<12}{worst:<12}{end}", flush=True)
    if aims:
        print(f"{'  aim at most; at the end at least':<44}{aims}", flush=True)


def main() -> None:
    """Print the table."""
    print(f"episodes until the noise-free return is above two thresholds, {len(SEEDS)} seeds; inf: not reached")
    print(f"{'':<32}{'above':<12}{'median':<12}{'worst':<12}at the end, least / mean (episodes)")
    for task in (PENDULUM, WRAP, TOY):
        report(task.config, task, rkhs_nac, task.aims)
    for name, task, sds in (("pendulum", PENDULUM, (1.0, 2.0, 4.0)), ("toy", TOY, (0.25, 0.5, 1.0))):
        for sd in sds:
            report(f"CMA-ES, {name}, sd {sd:g}", task, partial(cma_es, sd=sd))


if __name__ == "__main__":
    main()
