"""Measure updates of the policy at growing numbers of samples, and matching pursuit beside that of scikit-learn.

Time is the median over repeats on one core. Memory is the peak of one more pass, which is traced.
"""

from __future__ import annotations

import os
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from sklearn.linear_model import OrthogonalMatchingPursuit

from command import parser
from rkhs_ros.app.inline import runner_of
from rkhs_ros.learning.algorithms.algorithm import Experience
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rkhs.pursuit import Pursuit, pursue
from rkhs_ros.runs.config import load_config
from timing import growth, seconds_of

CONFIGS = Path(__file__).parents[1] / "config"
POINTS, ATOMS = 1000, 40


class Sizes(NamedTuple):
    """The size of the benchmark.

    Attributes:
        repeats: repeats of an update, by its number of samples.
        many: samples of one more update.
        iterations: iterations of training before the update.
        pursuits: repeats of a matching pursuit.
    """

    repeats: dict[int, int]
    many: int
    iterations: int
    pursuits: int


FULL = Sizes({1_000: 21, 10_000: 7, 100_000: 3}, many=1_000_000, iterations=3, pursuits=31)
QUICK = Sizes({100: 1, 200: 1}, many=200, iterations=1, pursuits=1)


def peak_of(call: Callable[[], object]) -> int:
    """Return the peak memory of a call, in bytes."""
    tracemalloc.start()
    call()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def update_of(
    config: Path, samples: int, iterations: int, changes: Sequence[str] = ()
) -> tuple[Callable[[], object], int]:
    """Return an update after some iterations, on episodes with a number of steps, and the centres of the policy."""
    settings = load_config(config, [*changes, f"iterations={iterations}"])
    training, environment = settings.training, settings.environment
    runner = runner_of(environment)
    *_, last = train(training, runner)
    batch = Batch(1, 0, samples // training.horizon, training.horizon, explore=True)
    episodes = runner.collect(last.policy, batch).with_inputs(last.policy.inputs)
    memory = episodes.take(slice(0))

    def collect(policy: GaussianPolicy, rows: int) -> Episodes:
        raise RuntimeError("these step rules try nothing out")

    experience = Experience(episodes, training.discount, memory, collect, np.ones(episodes.actions.shape[2]))
    return lambda: training.algorithm.update(last.policy, experience), last.metrics.centres


def updates(config: Path, sizes: Sizes, changes: Sequence[str] = (), aim: float = 30.0) -> None:
    """Print time and memory of the update of a policy with the greatest number of centres."""
    name = " ".join([config.stem, *(change.rpartition(".")[2] for change in changes)])
    seconds: dict[int, float] = {}
    memory: dict[int, float] = {}
    for samples, repeats in sizes.repeats.items():
        update, centres = update_of(config, samples, sizes.iterations, changes)
        seconds[samples], memory[samples] = seconds_of(update, repeats), peak_of(update)
        note = f"   (aim {aim:.0f} ms)" if samples == min(sizes.repeats) else ""
        size = f"{samples:>6} samples, {centres:>4} centres"
        print(
            f"{name:<40}{size}  {1e3 * seconds[samples]:8.1f} ms  {memory[samples] / 2**20:8.1f} MiB{note}", flush=True
        )
    least, most = min(sizes.repeats), max(sizes.repeats)
    print(
        f"{name:<40}growth from {least} to {most}    {growth(seconds, least, most):8.2f}"
        f"     {growth(memory, least, most):8.2f}       (aim at most 1.1)",
        flush=True,
    )


def pursuits(repeats: int) -> None:
    """Print residual and time of our orthogonal matching pursuit and that of scikit-learn, on one dictionary."""
    rng = np.random.default_rng(0)
    points, candidates = rng.uniform(-3.0, 3.0, (2, POINTS, 2))
    targets = np.sin(2 * points[:, :1]) * np.cos(points[:, 1:]) + 0.1 * rng.standard_normal((POINTS, 1))
    kernel = RBF((1.0,))

    def form() -> np.ndarray:
        columns = kernel(points, candidates)
        return columns / np.linalg.norm(columns, axis=0)

    dictionary = form()
    theirs = OrthogonalMatchingPursuit(n_nonzero_coefs=ATOMS, fit_intercept=False)

    def fit_ours() -> Pursuit:
        return pursue(kernel, points, targets, candidates, budget=ATOMS, fitting="back_fitting")

    def fit_theirs() -> object:
        return theirs.fit(dictionary, targets[:, 0])

    def error(fitted: np.ndarray) -> float:
        return float(np.linalg.norm(targets[:, 0] - fitted) / np.linalg.norm(targets))

    our_seconds, their_seconds, forming = (seconds_of(call, repeats) for call in (fit_ours, fit_theirs, form))
    ours = fit_ours()
    print(f"pursuit of {len(ours.chosen)} among {POINTS} candidates, {POINTS} points; residual relative to the targets")
    print(
        f"back-fitting, all from the points        {1e3 * our_seconds:8.1f} ms   "
        f"residual {error(ours.function(points)[:, 0]):.6f}"
    )
    print(
        f"scikit-learn, the dictionary ready-made  {1e3 * their_seconds:8.1f} ms   "
        f"residual {error(theirs.predict(dictionary)):.6f}   {their_seconds / our_seconds:.2f} times ours (aim 3)"
    )
    both = their_seconds + forming
    print(f"scikit-learn, with forming it            {1e3 * both:8.1f} ms   {both / our_seconds:26.2f} times ours")


def at_many(config: Path, sizes: Sizes) -> None:
    """Print time and memory of an update with very many samples."""
    update, centres = update_of(config, sizes.many, sizes.iterations)
    seconds, peak = seconds_of(update, 1), peak_of(update) / 2**20
    size = f"{sizes.many} samples, {centres:>4} centres"
    print(f"{config.stem:<39}{size}  {seconds:8.2f} s {peak:8.1f} MiB (aim 4 s, 1024 MiB)", flush=True)


def once(config: Path, sizes: Sizes, aim: str, changes: Sequence[str] = ()) -> None:
    """Print the time of an update with the fewest samples only."""
    samples = min(sizes.repeats)
    update, centres = update_of(config, samples, sizes.iterations, changes)
    name = " ".join([config.stem, *(change.rpartition(".")[2] for change in changes)])
    size = f"{samples:>6} samples, {centres:>4} centres"
    print(f"{name:<40}{size}  {1e3 * seconds_of(update, 9):8.1f} ms   {aim}", flush=True)


def main(sizes: Sizes) -> None:
    """Print the tables."""
    for name in ("ac", "npg", "nac", "power", "grid_ac", "enac", "grid_power"):
        updates(CONFIGS / f"pendulum_{name}.yaml", sizes)
    updates(CONFIGS / "pendulum_nac.yaml", sizes, ["algorithm.critic=trajectory"])
    updates(CONFIGS / "pendulum_nac.yaml", sizes, ["algorithm.regression=pursuit"])
    for name in ("ac", "npg", "nac", "power"):
        once(CONFIGS / f"pendulum_pomdp_{name}.yaml", sizes, "(aim 100 ms)")
    once(CONFIGS / "pendulum_pomdp_enac.yaml", sizes, "")
    printed = ["algorithm.weighting=as_published"]
    once(CONFIGS / "pendulum_power.yaml", sizes, "as printed: cubic in the samples", printed)
    for name in ("ac", "npg", "nac", "power", "grid_ac", "enac", "grid_power"):
        at_many(CONFIGS / f"pendulum_{name}.yaml", sizes)
    pursuits(sizes.pursuits)


if __name__ == "__main__":
    main(QUICK if parser(__doc__).parse_args().quick else FULL)
