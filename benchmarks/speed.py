"""Measure the time of updates of the policy, of fits of a dynamics model, and of rollouts in the model.

Time is the median over repeats on one core. Memory is the peak of one more pass, which is traced.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from command import growth, parser, seconds_of
from rkhs_ros.app.inline import runner_of
from rkhs_ros.learning.algorithms.algorithm import Experience
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.runs.config import load_config

CONFIGS = Path(__file__).parents[1] / "config"
ALGORITHMS = "ac", "nac", "power"  # that have a configuration with and without a window


class Sizes(NamedTuple):
    """The size of the benchmark.

    Attributes:
        repeats: repeats of an update, by its number of samples.
        many: samples of one more update.
        iterations: iterations of training before the update.
    """

    repeats: dict[int, int]
    many: int
    iterations: int


FULL = Sizes({1_000: 21, 10_000: 7, 100_000: 3}, many=1_000_000, iterations=3)
QUICK = Sizes({100: 1, 200: 1}, many=200, iterations=1)


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


HORIZON, NUM_ENVS = 100, (50, 200)
STEPS = (1_250, 2_500, 5_000, 10_000)
MODEL_CENTRES, POLICY_CENTRES = 200, 80
TASKS = {"pendulum": (2, 1), "hopper": (11, 3), "cheetah": (17, 6)}  # sizes of an observation and an action


def spaces_of(d: int, n: int) -> Spaces:
    """Return the spaces of a task, with actions between -1 and 1."""
    return Spaces((d,), np.full(n, -1.0), np.full(n, 1.0))


def episodes_of(d: int, n: int, steps: int) -> Episodes:
    """Return episodes of a nonlinear system with d numbers in an observation and n in an action."""
    rng = np.random.default_rng(0)
    rows = -(-steps // HORIZON)
    by_state, by_action = rng.normal(size=(d, d)) / np.sqrt(d), rng.normal(size=(n, d))
    observations = np.empty((rows, HORIZON + 1, d))
    observations[:, 0] = rng.normal(size=(rows, d))
    actions = rng.uniform(-1.0, 1.0, (rows, HORIZON, n))
    for t in range(HORIZON):
        now = observations[:, t]
        change = np.tanh(2.0 * now @ by_state + actions[:, t] @ by_action) - 0.2 * now
        observations[:, t + 1] = now + 0.1 * change + 0.01 * rng.normal(size=now.shape)
    rewards = np.exp(-np.mean(observations[:, :-1] ** 2, axis=2)) - 0.1 * np.mean(actions**2, axis=2)
    mask = np.ones((rows, HORIZON), dtype=bool)
    return Episodes(observations[:, :-1], actions, rewards, mask, observations[:, -1], np.zeros(rows, dtype=bool))


def policy_of(d: int, n: int) -> GaussianPolicy:
    """Return a policy with the greatest number of centres."""
    rng = np.random.default_rng(1)
    mean = Function(
        RBF((np.sqrt(d),)), rng.normal(size=(POLICY_CENTRES, d)), 0.1 * rng.normal(size=(POLICY_CENTRES, n))
    )
    return GaussianPolicy(mean, ConstantVariance(np.full(n, 0.1)))


def fits(name: str, sizes: Sequence[int], repeats: int) -> None:
    """Print the time of a fit at growing numbers of steps."""
    d, n = TASKS[name]
    seconds = {}
    for steps in sizes:
        episodes = episodes_of(d, n, steps)
        seconds[steps] = seconds_of(
            partial(DynamicsModel.fit, episodes, Inputs(), spaces_of(d, n), MODEL_CENTRES), repeats
        )
        aim = "   (aim 2 s)" if steps == 5_000 else ""
        print(f"fit, {name:<9} {d:>2} + {n} numbers, {steps:>6} steps   {seconds[steps]:6.2f} s{aim}", flush=True)
    print(f"fit, {name:<9} growth {growth(seconds, sizes[0], sizes[-1]):.2f}   (aim at most 1)", flush=True)


def rollouts(name: str, steps: int, repeats: int) -> None:
    """Print the steps per second of model rollouts, with a model fitted to a number of steps."""
    d, n = TASKS[name]
    model = DynamicsModel.fit(episodes_of(d, n, steps), Inputs(), spaces_of(d, n), MODEL_CENTRES)
    runner, policy = ModelRunner(model), policy_of(d, n)
    for num_envs in NUM_ENVS:
        batch = Batch(2, 0, num_envs, HORIZON, explore=True)
        rate = num_envs * HORIZON / seconds_of(partial(runner.collect, policy, batch), repeats)
        aim = "   (aim 200000)" if name == "pendulum" else ""
        print(
            f"rollouts, {name:<9} {d:>2} + {n} numbers, {num_envs:>4} rollouts   {rate:9.0f} steps/s{aim}", flush=True
        )


def main(sizes: Sizes) -> None:
    """Print the tables."""
    for name in TASKS if sizes is FULL else ("pendulum",):
        rollouts(name, steps=2_000 if sizes is FULL else 100, repeats=9 if sizes is FULL else 1)
    fits(*("cheetah", STEPS, 3) if sizes is FULL else ("pendulum", (100, 200), 1))
    for name in ALGORITHMS:
        updates(CONFIGS / f"pendulum_{name}.yaml", sizes)
    updates(CONFIGS / "pendulum_nac.yaml", sizes, ["algorithm.critic=trajectory"])
    updates(CONFIGS / "pendulum_nac.yaml", sizes, ["algorithm.critic=pursuit"])
    for name in ALGORITHMS:
        once(CONFIGS / f"pendulum_pomdp_{name}.yaml", sizes, "(aim 100 ms)")
    once(CONFIGS / "pendulum_pomdp_enac.yaml", sizes, "")
    printed = ["algorithm.weighting=as_published"]
    once(CONFIGS / "pendulum_power.yaml", sizes, "as printed: cubic in the samples", printed)
    for name in ALGORITHMS:
        at_many(CONFIGS / f"pendulum_{name}.yaml", sizes)


if __name__ == "__main__":
    main(QUICK if parser(__doc__).parse_args().quick else FULL)
