"""Measure the returns of the configurations in ``config/`` on held-out seeds, and the episodes to thresholds.

No setting was chosen on the seeds from 100 on, which the documentation uses. Episodes count until the evaluation
return, the mean of 10 evaluation episodes after an update, first reaches a threshold.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import sys
from argparse import Namespace
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from command import ended, parsed, parser
from rkhs_ros.app.inline import iterations
from rkhs_ros.app.study import add_jobs_argument, parse_seeds
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import pick, require
from rkhs_ros.learning.training_settings import NoModel
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.studies.aggregates import Estimate, median_over_runs
from rkhs_ros.studies.workers import run_parallel
from trial import as_csv, locked, median_until, rows_of

CONFIGS = Path(__file__).parents[1] / "config"
EVALUATION_EPISODES = 10
THRESHOLDS = {  # two per task, of the discounted evaluation return, close to the best possible one
    "rkhs/Pendulum-v0": (45.0, 50.0),
    "rkhs/PendulumPOMDP-v0": (45.0, 50.0),
    "rkhs/Toy-v0": (14.0, 14.2),
}
Curve = Iterable[tuple[int, float]]  # episodes used, and evaluation return, after each update


class Result(NamedTuple):
    """The result of one run.

    Attributes:
        name: name of the configuration.
        seed: seed of the run.
        episodes: total number of exploration episodes.
        evaluation_return: discounted evaluation return at the end.
        until_first: exploration episodes until the evaluation return first reached the task's first threshold; infinite
            if it never did.
        until_second: the same for the second threshold.
    """

    name: str
    seed: int
    episodes: int
    evaluation_return: float
    until_first: float
    until_second: float


def names() -> list[str]:
    """Return the configurations without a model whose task has thresholds; the table of tasks measures the others."""
    configs = {path.stem: load_config(path) for path in sorted(CONFIGS.glob("*.yaml"))}
    return [
        name
        for name, config in configs.items()
        if config.environment.id in THRESHOLDS and isinstance(config.training.model, NoModel)
    ]


@one_thread()
def measure(name: str, seed: int, changes: Sequence[str] = ()) -> Result:
    """Train with a seed."""
    evaluation = f"evaluation_episodes={EVALUATION_EPISODES}"
    config = load_config(CONFIGS / f"{name}.yaml", [f"seed={seed}", evaluation, *changes])
    return result_of(name, seed, thresholds_of(name), learnt(config))


def learnt(config: Config) -> Iterator[tuple[int, float]]:
    """Yield the learning curve of a configuration."""
    for iteration in iterations(config):
        yield iteration.episodes_used, float(iteration.evaluation_returns.mean())


def result_of(name: str, seed: int, thresholds: Sequence[float], curve: Curve) -> Result:
    """Return the result of a learning curve."""
    episodes, returns = np.array(list(curve), dtype=float).T
    first, second = (float(min(episodes[returns >= each], default=np.inf)) for each in thresholds)
    return Result(name, seed, int(episodes[-1]), float(returns[-1]), first, second)


def text_of(results: Iterable[Result]) -> str:
    """Return the results as CSV, one line per run, sorted by name and seed."""
    lines = [each._replace(evaluation_return=f"{each.evaluation_return:.3f}") for each in sorted(results)]
    return as_csv(Result._fields, lines)


def read_results(path: Path) -> list[Result]:
    """Return the results in a file of `text_of`."""
    return rows_of(path, Result._fields, _row)


def add_results(path: Path, results: Iterable[Result]) -> None:
    """Add results to a file, instead of those of the same configurations and seeds."""
    with locked(path):
        found = {each[:2]: each for each in [*(read_results(path) if path.exists() else []), *results]}
        write_whole(path, text_of(found.values()).encode())


def _row(name: str, seed: str, episodes: str, *rest: str) -> Result:
    return Result(name, int(seed), int(episodes), *map(float, rest))


class Summary(NamedTuple):
    """The results of a configuration: medians with 95 % bootstrap intervals over the seeds, and the worst run.

    Attributes:
        seeds: seeds of the runs, such as "100 to 119".
        episodes: total number of exploration episodes.
        until: episodes until the first and the second threshold; infinite if not reached.
        worst_until: greatest of these, or the number of seeds that never reach the threshold.
        end: evaluation return at the end.
        least: the least of these.
    """

    seeds: str
    episodes: int
    until: tuple[Estimate, Estimate]
    worst_until: tuple[str, str]
    end: Estimate
    least: float


def summaries(results: Iterable[Result]) -> dict[str, Summary]:
    """Return the summary of the runs of each name."""
    runs: dict[str, list[Result]] = {}
    for result in results:
        runs.setdefault(result.name, []).append(result)
    return {name: _summary(each) for name, each in runs.items()}


def _summary(runs: Sequence[Result]) -> Summary:
    seeds = sorted(run.seed for run in runs)
    whole = seeds == list(range(seeds[0], seeds[-1] + 1))
    until = np.array([[run.until_first, run.until_second] for run in runs]).T
    ends = np.array([run.evaluation_return for run in runs])
    return Summary(
        seeds=f"{seeds[0]} to {seeds[-1]}" if whole else ", ".join(map(str, seeds)),
        episodes=runs[0].episodes,
        until=(median_until(until[0]), median_until(until[1])),
        worst_until=(_worst(until[0]), _worst(until[1])),
        end=median_over_runs(ends),
        least=ends.min(),
    )


def _worst(until: Array) -> str:
    never = int(np.isinf(until).sum())
    return f"{never} never" if never else f"{until.max():g}"


HEADS = ("Configuration", "Seeds", "Until {:g}", "Worst", "Until {:g}", "Worst", "Return at the end", "Least", "After")


def as_markdown(results: Iterable[Result]) -> str:
    """Return one table per pair of thresholds of which there are results."""
    found = summaries(results)
    tables: dict[tuple[float, ...], dict[str, Summary]] = {thresholds: {} for thresholds in THRESHOLDS.values()}
    for name, each in found.items():
        tables[thresholds_of(name)][name] = each
    return "\n".join(_table(thresholds, its) for thresholds, its in tables.items() if its)


def thresholds_of(name: str) -> tuple[float, ...]:
    """Return the thresholds of the task of a configuration; raise ValueError if there are none."""
    return pick(load_config(CONFIGS / f"{name}.yaml").environment.id, THRESHOLDS, "task with thresholds")


def _table(thresholds: tuple[float, ...], found: dict[str, Summary]) -> str:
    head = " | ".join(HEADS).format(*thresholds)
    lines = [f"| {head} |", "|---" * len(HEADS) + "|"]
    for name, each in found.items():
        until = " | ".join(f"{e} | {w}" for e, w in zip(each.until, each.worst_until, strict=True))
        lines.append(f"| `{name}` | {each.seeds} | {until} | {end_of(each)} | {each.least:.2f} | {each.episodes} |")
    return "\n".join([*lines, ""])


def end_of(summary: Summary) -> str:
    """Return the median final return and its interval, with two decimals."""
    return str(Estimate(*np.round(summary.end, 2)))


FEW, MANY = "100-109", "100-119"
WITH_MANY = ("pendulum_few_nac", "pendulum_wrap_few_nac")
QUICK = ["pendulum_few_nac", "toy_nac"]
QUICK_CHANGES = ("iterations=2", "horizon=5")


def seeds_of(name: str) -> str:
    """Return the seeds of the figures in the documentation."""
    return MANY if name in WITH_MANY else FEW


def main(options: Namespace) -> None:
    """Train what is requested, store each result, and print the tables."""
    for name in options.names:
        thresholds_of(name)  # fails before the training rather than after it
    require(not options.tables or options.out is not None, "--tables", "--out with the file of the results", "none")
    changes = QUICK_CHANGES if options.quick else ()
    work = [
        (name, seed, changes)
        for name in ([] if options.tables else options.names or names())
        for seed in parse_seeds(options.seeds or seeds_of(name))
    ]
    results: list[Result] = []
    if options.out and not options.tables:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        add_results(options.out, [])  # fails before the training rather than after it
    for result in run_parallel(measure, work, jobs=options.jobs, title="runs", quiet=options.quick):
        results.append(result)
        if options.out:
            add_results(options.out, [result])
    print(as_markdown(sorted(read_results(options.out) if options.out else results)), end="")


if __name__ == "__main__":
    command = parser(__doc__)
    command.add_argument("names", nargs="*", metavar="NAME", help="configurations (all)")
    command.add_argument("--seeds", help="such as 100-119 or 100,105 (those of the documentation)")
    command.add_argument("--out", type=Path, metavar="FILE.csv", help="add the results to this file")
    command.add_argument("--tables", action="store_true", help="only print the tables of the file")
    add_jobs_argument(command)
    from configurations import main as run  # by the name under which worker processes import it

    sys.exit(ended(lambda: run(parsed(command, names=QUICK, seeds="100-101"))))
