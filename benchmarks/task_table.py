"""Make the table of tasks and its summary on the page from the stored curves.

Profiles and probabilities of improvement follow Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the
Statistical Precipice": the runs of each task are resampled separately, and each task has the same weight.
"""

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.studies.aggregates import CONFIDENCE, RESAMPLES, SEED, Estimate, mean_over_runs
from task_learners import LEARNERS
from trial import TASKS, Curves, Point, Task, as_csv, median_until

PAGE = Path(__file__).parents[1] / "docs" / "tasks.md"
RESULTS = PAGE.parent / "results" / "tasks"
TABLE = RESULTS / "table.csv"
PUBLISHED = RESULTS / "published.csv"  # by others
BEGIN, END = "<!-- made by benchmarks/tasks.py -->\n", "<!-- end -->\n"
AFTER = (5, 10, 20, 50, 100)  # episodes
SCORES = ("episodes", "steps", "return")


class Cell(NamedTuple):
    """The curves of a learner on a task."""

    task: Task
    curves: Sequence[Sequence[Point]]

    def returns(self, curve: Sequence[Point]) -> Array:
        """Return the returns of a curve that the thresholds are for."""
        return np.array([p.discounted_return if self.task.discounted else p.undiscounted_return for p in curve])

    def first(self, threshold: float) -> list[int | None]:
        """Return the number of the first point of each curve that reaches a threshold."""
        reached = [np.flatnonzero(self.returns(curve) >= threshold) for curve in self.curves]
        return [int(each[0]) if len(each) else None for each in reached]

    def until(self, threshold: float, measure: str) -> Estimate:
        """Return the median ``episodes`` or ``steps`` until a threshold; infinite where it is not reached."""
        return median_until(self.counts(threshold, measure))

    @property
    def action_repeat(self) -> float:
        """Median number of steps for which the policies hold an action at the end."""
        return float(np.median([curve[-1].action_repeat for curve in self.curves]))

    def reached(self) -> int:
        """Return the number of runs that reached the first threshold."""
        return sum(at is not None for at in self.first(self.task.thresholds[0]))

    def shown(self) -> str:
        """Return the median episodes until the first threshold, its interval and how many runs reached it."""
        reached, runs = self.reached(), len(self.curves)
        number = f"{runs}" if reached == runs else f"{reached} of {runs}"
        return f"{shown(self.until(self.task.thresholds[0], 'episodes'))} ({number})"

    def median(self) -> str:
        """Return the median episodes until the first threshold, without its interval."""
        return shown(self.until(self.task.thresholds[0], "episodes")._replace(low=np.nan))

    def counts(self, threshold: float, measure: str) -> Array:
        """Return the ``episodes`` or ``steps`` of each curve until a threshold; infinite where it is not reached."""
        counts = [
            np.inf if at is None else float(getattr(curve[at], measure))
            for at, curve in zip(self.first(threshold), self.curves, strict=True)
        ]
        return np.array(counts)

    def until_success(self) -> Estimate:
        """Return the median episodes until 90 % of the evaluation episodes meet the task's own criterion."""
        counts = [[p.episodes for p in curve if p.succeeded >= 0.9] for curve in self.curves]
        return median_until(np.array([its[0] if its else np.inf for its in counts]))

    def scores(self, how: str) -> Array:
        """Return a score of each curve: minus the episodes or steps to the first threshold, the last or mean return."""
        if how == "return":
            return np.array([self.returns(curve)[-1] for curve in self.curves])
        if how == "mean return":
            return np.array([self.returns(curve).mean() for curve in self.curves])
        return -self.counts(self.task.thresholds[0], how)

    def after(self, episodes: int) -> Array:
        """Return the return of each curve at its last point within a number of episodes; nan if it ends earlier."""
        return np.array([self._after(curve, episodes) for curve in self.curves])

    def _after(self, curve: Sequence[Point], episodes: int) -> float:
        within = [number for number, point in enumerate(curve) if point.episodes <= episodes]
        return float(self.returns(curve)[within[-1]]) if within and curve[-1].episodes >= episodes else np.nan

    def below(self, threshold: float) -> str:
        """Return how many of the points after the first success are below the threshold."""
        later = [
            self.returns(curve)[at + 1 :] < threshold
            for at, curve in zip(self.first(threshold), self.curves, strict=True)
            if at is not None
        ]
        count = sum(map(len, later))
        return f"{sum(each.sum() for each in later) / count:.0%}" if count else "-"


Cells = dict[str, dict[str, Cell]]  # by task and learner


def cells_of(curves: Curves, learners: Iterable[str] = LEARNERS) -> Cells:
    """Return the cells in the order of the tables and of the learners."""
    found: Cells = {}
    for task in TASKS:
        for learner in learners:
            its = [curve for key, curve in curves.items() if key[:2] == (task, learner)]
            if its:
                found.setdefault(task, {})[learner] = Cell(TASKS[task], its)
    return found


def line_of(task: str, learner: str, cell: Cell) -> tuple[str, ...]:
    """Return the line of a learner on a task in the table."""
    thresholds, rate = cell.task.thresholds, cell.task.rate
    episodes = [cell.until(threshold, "episodes") for threshold in thresholds]
    steps = [cell.until(threshold, "steps") for threshold in thresholds]
    seconds = [Estimate(*(each / rate for each in estimate)) for estimate in steps]
    cost = np.median([curve[-1].cpu_seconds / curve[-1].episodes for curve in cell.curves])
    return (
        task,
        learner,
        str(len(cell.curves)),
        " / ".join(with_minus(f"{threshold:g}") for threshold in thresholds),
        *(" / ".join(map(shown, each)) for each in (episodes, steps, seconds)),
        shown(cell.until_success()) if cell.task.success else "-",
        *(shown(mean_over_runs(cell.after(count))) for count in AFTER),
        cell.below(thresholds[0]),
        f"{cost:.2g}",
    )


HEAD = (
    *(
        "task",
        "learner",
        "seeds",
        "thresholds",
        "episodes to them",
        "steps to them",
        "seconds to them",
        "episodes to success",
    ),
    *(f"return after {count}" for count in AFTER),
    *("later below", "CPU s per episode"),
)


def shown(estimate: Estimate) -> str:
    """Return three digits of an estimate and its interval."""
    if np.isnan(estimate.value):
        return "-"
    rounded = [float(f"{each:.3g}") if np.isfinite(each) else each for each in estimate]
    numbers = [
        "never" if np.isinf(each) else with_minus(f"{each:,.0f}" if abs(each) >= 1000.0 else f"{each:g}")
        for each in rounded
    ]
    alone = np.isnan(estimate.low) or numbers == ["never"] * 3
    return numbers[0] if alone else f"{numbers[0]} [{numbers[1]}, {numbers[2]}]"


def with_minus(text: str) -> str:
    """Return a number with a minus sign in place of a hyphen."""
    return text.replace("-", "\u2212") if text.startswith("-") else text


def summary(cells: Cells) -> str:
    """Return two tables in Markdown: the median episodes until the first threshold, and ours against each learner.

    Between them are the episodes that ours needed for the criteria that tasks have besides the return.
    """
    learners = [learner for learner in LEARNERS if any(learner in its for its in cells.values())]
    lines = ["| Task | Return | " + " | ".join(f"`{learner}`" for learner in learners) + " | Later below | At most |"]
    lines.append("|---" * (4 + len(learners)) + "|")
    for task, its in cells.items():
        threshold = TASKS[task].thresholds[0]
        found = [_shown(its, each) for each in learners]
        name = f"[`{task}`](results/tasks/{task}.png)" if "ours" in its else f"`{task}`"
        kept = its["ours"].below(threshold) if "ours" in its else "-"
        lines.append(
            f"| {name} | {with_minus(f'{threshold:g}')} | {' | '.join(found)} | {kept} | {TASKS[task].episodes} |"
        )
    for task, its in cells.items():
        if "ours" in its and TASKS[task].success:
            needed = shown(its["ours"].until_success())
            lines += ["", f"Until `{task}` is [balanced](#the-cart-pole), `ours` needs {needed} episodes."]
    lines += [
        "",
        "| `ours` against | Tasks | Fewer episodes | Fewer steps | Higher return at the end |",
        "|---" * 5 + "|",
    ]
    for learner in learners:
        both = [its for its in cells.values() if learner != "ours" and {"ours", learner} <= set(its)]
        if len(both) > 1:
            found = [percents(compared(both, "ours", learner, how)) for how in SCORES]
            lines.append(f"| `{learner}` | {len(both)} | {' | '.join(found)} |")
    return "\n".join([*lines, "", *published(cells), ""])


def _shown(its: Mapping[str, Cell], learner: str) -> str:
    """Return the cell of a learner; "=" if it holds actions, but ours does not, so that it is the one that does not."""
    if learner in its:
        return its[learner].shown()
    held = its["ours"].action_repeat if LEARNERS[learner].holds_actions and "ours" in its else 0.0
    return "=" if held == 1.0 else "-"


def published(cells: Cells) -> list[str]:
    """Return a table in Markdown of published returns, means over seeds, beside those at the end of ours."""
    with PUBLISHED.open(newline="") as file:
        found = [((line["task"], line["learner"]), float(line["return"])) for line in csv.DictReader(file)]
    returns = {key: np.mean([value for name, value in found if name == key]) for key, _ in found}
    learners = dict.fromkeys(learner for _, learner in returns)
    lines = [f"| Task | `ours` | after episodes | {' | '.join(f'{each}, 100 episodes' for each in learners)} |"]
    lines.append("|---" * (3 + len(learners)) + "|")
    for task in dict.fromkeys(task for task, _ in returns):
        if ours := cells.get(task, {}).get("ours"):
            values = " | ".join(f"{returns[task, learner]:.0f}" for learner in learners)
            end = shown(mean_over_runs(ours.scores("return")))
            lines.append(f"| `{task}` | {end} ({len(ours.curves)}) | {ours.task.episodes} | {values} |")
    return lines


def compared(both: Sequence[Mapping[str, Cell]], one: str, other: str, how: str) -> Estimate:
    """Return the probability that one learner has a better score than the other, over tasks with cells of both."""
    return improvement(*([its[each].scores(how) for its in both] for each in (one, other)))


def percents(estimate: Estimate) -> str:
    """Return a probability and its interval in percent."""
    return f"{estimate.value:.0%} [{estimate.low:.0%}, {estimate.high:.0%}]"


def improvement(ours: Sequence[Array], theirs: Sequence[Array]) -> Estimate:
    """Return the probability of improvement: that a run of ours has a greater score than one of theirs.

    Given are the scores of the runs on each task. Equal scores count as half.
    """
    wins = [(x[:, None] > y) + 0.5 * (x[:, None] == y) for x, y in zip(ours, theirs, strict=True)]

    def drawn(rng: np.random.Generator, each: Array) -> Array:
        rows, columns = (rng.integers(count, size=(RESAMPLES, count)) for count in each.shape)
        return each[rows[:, :, None], columns[:, None, :]].mean(axis=(1, 2))

    return _over_tasks([each.mean() for each in wins], wins, drawn)


def profile(counts: Sequence[Array], at: Array) -> Estimate:
    """Return the share of the runs that needed at most each count of ``at``.

    Given are the counts of the runs of each task, infinite for runs that did not end.
    """
    return mean_over_tasks([(each[:, None] <= at).astype(np.float64) for each in counts])


def mean_over_tasks(samples: Sequence[Array]) -> Estimate:
    """Return the mean over tasks of the means over their runs, the first axis."""

    def drawn(rng: np.random.Generator, each: Array) -> Array:
        return each[rng.integers(len(each), size=(RESAMPLES, len(each)))].mean(axis=1)

    return _over_tasks([each.mean(axis=0) for each in samples], samples, drawn)


def _over_tasks(
    values: Sequence[Array], samples: Sequence[Array], drawn: Callable[[np.random.Generator, Array], Array]
) -> Estimate:
    """Return the mean of a statistic over tasks, with the percentile interval of its draws."""
    rng = np.random.default_rng(SEED)
    means = np.mean([drawn(rng, each) for each in samples], axis=0)
    low, high = np.quantile(means, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0], axis=0)
    return Estimate(np.mean(values, axis=0), low, high)


def text_of_table(cells: Mapping[str, Mapping[str, Cell]]) -> str:
    """Return the table as CSV, one line per task and learner."""
    return as_csv(HEAD, (line_of(task, learner, cell) for task, its in cells.items() for learner, cell in its.items()))


def page_with(summary: str, begin: str = BEGIN) -> str:
    """Return the page with a summary in place of its own."""
    before, rest = PAGE.read_text().split(begin)
    return before + begin + "\n" + summary + "\n" + END + rest.split(END, 1)[1]
