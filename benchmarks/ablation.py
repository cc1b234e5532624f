"""Measure what each part of model-based training earns: train without one part at a time, on seeds that chose none.

Each finished curve is stored in docs/results/ablation/ at once, with the name of the part in place of the learner's, or
"all". The same command continues after an interruption, and makes the table and the picture of what is stored.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from operator import attrgetter
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib.figure import Figure

import tasks
from command import ended, parser
from rkhs_ros.learning import training
from rkhs_ros.learning.model import dynamics_model, model_rollouts, rewards, termination
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model_based import training_in_model
from rkhs_ros.learning.model_based.real_experience import RealExperience
from rkhs_ros.learning.model_based.validation import PATIENCE, Validation
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.rkhs.evidence import BANDWIDTHS, SMOOTH
from rkhs_ros.studies.aggregates import Estimate
from task_table import RESULTS, Cell, cells_of, mean_over_tasks, percents
from trial import TASKS, Curves, Key, Point, Trial, as_csv, read_curves

FILES = RESULTS.parent / "ablation"
FILE = FILES / "curves.csv"
ALL = "all"
ALIKE = {"cart-pole": 8, "furuta": 8, "pendulum-clip": 3}  # tasks whose episodes start alike, and how many episodes
VARYING = {"ball-on-beam": 10, "tanks": 10, "Pendulum-v1": 7, "Reacher-v5": 10, "MountainCarContinuous-v0": 4}
EPISODES = {**ALIKE, **VARYING}
NEVER = 10**9
Curve = list[Point]
RETURNS = attrgetter("undiscounted_return", "discounted_return", "least_return")
SCORES = {"episodes": "fewer episodes with it", "mean return": "higher returns with it"}
QUICK = {"tasks": ["pendulum-clip"], "parts": ["walls"], "seeds": "200"}


def _explorer(*its: Any) -> training_in_model.Trained:
    trained = training_in_model.train_in_model(*its)
    return replace(trained, policy=trained.explorer)


def _last_policy(policy: Any, experience: Any, inputs: Any) -> Any:
    fits = inputs == policy.inputs and policy.mean.weights.any()
    return policy if fits else _fresh_policy(policy, experience, inputs)


def _recorded_start(model: Any, random: np.random.Generator) -> Any:
    return model.starts[random.integers(len(model.starts))]


def _own_functions(model: Any, *, worlds: Any = (), **others: Any) -> ModelRunner:
    return ModelRunner(model, **others)


def _nowhere(runner: Any, observations: Any) -> Any:
    return np.zeros((len(observations), observations.shape[1] - 1), dtype=bool)


_fresh_policy, learner = training_in_model._fresh_policy, training_in_model
# What removes each part, and the tasks where it may have an effect.
Part = tuple[Callable[[], AbstractContextManager[Any]], Iterable[str]]
PARTS: dict[str, Part] = {
    "reward margin": (lambda: patch.dict(ModelRunner.__init__.__kwdefaults__, reward_margin=0.0), EPISODES),
    "focus": (lambda: patch.object(dynamics_model, "_starts_vary", lambda *its: True), ALIKE),
    "finer ridges": (lambda: patch.object(learner, "FINER", 1.0), ALIKE),
    "optimism": (lambda: patch.object(RealExperience, "seeks_novelty", False), EPISODES),
    "decay of exploration": (lambda: patch.object(learner, "EXPLORATION_DECAY", 1.0), EPISODES),
    "fine exploration": (lambda: patch.object(learner, "FINE", learner.NARROW), VARYING),
    "visited starts": (lambda: patch.object(model_rollouts, "START_VISITED_EVERY", NEVER), EPISODES),
    "starts beyond": (lambda: patch.object(dynamics_model.DynamicsModel, "draw_start", _recorded_start), VARYING),
    "several worlds": (lambda: patch.object(learner, "WORLDS", 1), VARYING),
    "shared worlds": (lambda: patch.object(learner, "ModelRunner", _own_functions), EPISODES),
    "policy for use": (lambda: patch.object(training, "train_in_model", _explorer), EPISODES),
    "centred metric": (lambda: patch.object(ModelBased, "tries_centred_metric", False), EPISODES),
    "second training": (
        lambda: patch.object(Validation, "resume", lambda its: setattr(its, "_waited", PATIENCE)),
        EPISODES,
    ),
    "earlier policies": (lambda: patch.object(Validation, "consider_earlier", lambda *its: None), EPISODES),
    "training from 0": (lambda: patch.object(learner, "_fresh_policy", _last_policy), EPISODES),
    "walls": (lambda: patch.object(ModelRunner, "_beyond", _nowhere), EPISODES),
    "limits": (lambda: patch.object(termination.Limits, "of", lambda *its: None), ("ball-on-beam",)),
    "terminal function": (lambda: patch.object(termination, "FEWEST_ENDS", NEVER), ("ball-on-beam",)),
    "narrow peaks": (lambda: patch.object(rewards, "PEAKS", SMOOTH), ("MountainCarContinuous-v0",)),
    "narrow metric": (
        lambda: patch.object(rewards, "KINKS", rewards.KINKS._replace(metric_bandwidths=BANDWIDTHS)),
        EPISODES,
    ),
    "bounded rewards": (
        lambda: patch.object(rewards, "KINKS", rewards.KINKS._replace(bounded=False)),
        EPISODES,
    ),
    "cost of actions": (lambda: patch.object(rewards, "MOSTLY", 0.0), ("Reacher-v5", "MountainCarContinuous-v0")),
}


def learnt(key: Key, trial: Trial) -> tuple[Key, list[Point] | str]:
    """Train without the part that the key names; return its curve, or the error if it failed."""
    without = nullcontext if key.learner == ALL else PARTS[key.learner][0]
    with without():
        return key, tasks.learnt(key._replace(learner="ours"), trial)[1]


def asked(options: Namespace, curves: Curves) -> Iterator[tuple[Key, Trial]]:
    """Yield the missing curves, seed by seed, of the tasks whose packages are installed."""
    asked_for = [task for task in options.tasks if not tasks.is_skipped(task, "ours")]
    for seed in options.seeds:
        for part in (ALL, *options.parts):
            for task in EPISODES if part == ALL else PARTS[part][1]:
                if task in asked_for and (key := Key(task, part, seed)) not in curves:
                    trial = tasks.trial_of(TASKS[task], "ours", seed)
                    yield key, replace(trial, episodes=2 if options.quick else EPISODES[task])


def pairs_of(curves: Curves, part: str) -> dict[str, list[tuple[Curve, Curve]]]:
    """Return, for each task, the curves of the same seeds with and without a part."""
    found: dict[str, list[tuple[Curve, Curve]]] = {}
    for key, without in curves.items():
        if key.learner == part and (whole := curves.get(key._replace(learner=ALL))):
            found.setdefault(key.task, []).append((whole, without))
    return found


def gains(curves: Curves, how: str) -> dict[str, Estimate]:
    """Return, for each part, the probability over tasks that a run with it has a better score than without it.

    Runs of the same seed are compared, and equal scores count as half.
    """
    found = {}
    for part in PARTS:
        wins = []
        for task, pairs in pairs_of(curves, part).items():
            one, other = (Cell(TASKS[task], its).scores(how) for its in zip(*pairs, strict=True))
            wins.append((one > other) + 0.5 * (one == other))
        if wins:
            found[part] = mean_over_tasks(wins)
    return found


def same(curves: Curves, part: str) -> str:
    """Return how many curves are the same with and without a part."""
    pairs = [pair for its in pairs_of(curves, part).values() for pair in its]
    alike = [[*map(RETURNS, whole)] == [*map(RETURNS, without)] for whole, without in pairs]
    return f"{sum(alike)} of {len(alike)}"


def table(curves: Curves) -> str:
    """Return the probabilities and the median episodes until the first threshold as CSV, one line per part."""
    lines = []
    cells = cells_of(curves, (ALL, *PARTS))
    found = [{part: percents(gain) for part, gain in gains(curves, how).items()} for how in SCORES]
    for part in (ALL, *PARTS):
        medians = [_median(cells.get(task, {}).get(part)) for task in EPISODES]
        name, alike = (part, same(curves, part)) if part != ALL else ("nothing", "")
        lines.append((name, *(its.get(part, "") for its in found), alike, *medians))
    return as_csv(("without", *SCORES.values(), "same curves", *EPISODES), lines)


def _median(cell: Cell | None) -> str:
    """Return the median episodes until the first threshold, and the number of seeds, of a cell if there is one."""
    return f"{cell.median()} ({len(cell.curves)})" if cell else ""


def picture(curves: Curves) -> Figure:
    """Return the probabilities that training with a part is better."""
    figure = Figure((9.0, 4.8), layout="constrained")
    for panel, (how, title) in zip(figure.subplots(1, len(SCORES), sharey=True), SCORES.items(), strict=True):
        found = gains(curves, how)
        middle, low, high = 100 * np.array(list(found.values())).T
        panel.errorbar(middle, list(found), xerr=(middle - low, high - middle), fmt="o", markersize=4)
        panel.axvline(50.0, color="0.7", linewidth=0.8, linestyle=":")
        panel.set(xlabel=f"probability of {title}, %", xlim=(0.0, 100.0))
    panel.invert_yaxis()
    return figure


def run(options: Namespace) -> int:
    """Train the missing curves, store each, and print the table; return the exit code.

    The table and the picture of the page are made of its own curves alone.
    """
    code = tasks.train_and_store(learnt, asked(options, read_curves(options.curves)), options)
    curves = read_curves(options.curves)
    made = table(curves)
    print(made, end="")
    if options.curves == FILE.resolve():
        (FILES / "table.csv").write_text(made)
        picture(curves).savefig(FILES / "parts.png", dpi=100)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    choices: dict[str, Mapping[str, Any]] = {"tasks": EPISODES, "parts": PARTS}
    how: dict[str, Any] = {"seeds": "200-204", "curves": FILE, "quick": QUICK}
    return ended(lambda: run(tasks.options_of(parser(__doc__), arguments, choices, **how)))


if __name__ == "__main__":
    from ablation import main as run_main  # by the name under which worker processes import it

    sys.exit(run_main())
