"""Grid of settings, and the results of the runs at its points."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from io import StringIO
from itertools import product
from math import inf, prod
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import dumped, loaded
from rkhs_ros.learning.iteration import Row
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.report import provenance

MOST_POINTS = 10_000
OF_THE_TASK = ("horizon", "discount")  # and the environment; returns of different tasks are not comparable
OF_THE_COUNT = ("seed", "name", "timeout")  # do not change how a run learns


@dataclass(frozen=True)
class Variation:
    """A setting and the values that it takes."""

    name: str
    values: tuple[Any, ...]

    @property
    def changes(self) -> list[str]:
        """Changes of a configuration, one per value."""
        return [f"{self.name}={json.dumps(value)}" for value in self.values]


def parse_variations(texts: Iterable[str]) -> tuple[Variation, ...]:
    """Parse texts such as ``algorithm.ridge=1e-3,1e-2``; the values are YAML.

    Raises:
        ValueError: a text is not ``KEY=VALUE,VALUE ...``, a setting makes the returns incomparable, a setting is given
            twice, or the grid has too many points.
    """
    varied = tuple(map(_varied, texts))
    names = [each.name for each in varied]
    require(len(varied) > 0, "--vary", "KEY=VALUE,VALUE ...", "nothing")
    require(len(set(names)) == len(names), "--vary", "each setting once", " ".join(names))
    points = prod(len(each.values) for each in varied)
    require(points <= MOST_POINTS, "--vary", f"a grid of at most {MOST_POINTS} points", points)
    return varied


def _varied(text: str) -> Variation:
    name, equals, values = (part.strip() for part in text.partition("="))
    require(bool(name and equals and values), "--vary", "KEY=VALUE,VALUE ...", f"'{text}'")
    require(name not in OF_THE_COUNT, "--vary", "settings of the learner (use --seeds for seeds)", name)
    same_task = name not in OF_THE_TASK and not name.startswith("environment")
    require(same_task, "--vary", "settings that do not change the task, so that the returns are comparable", name)
    try:
        given = loaded(f"[{values}]")
    except ValueError as error:
        raise ValueError(f"--vary: expected values in YAML, got '{text}'") from error
    distinct = {json.dumps(value) for value in given}
    require(len(distinct) == len(given), f"--vary: {name}", "distinct values", values)
    return Variation(name, tuple(given))


def points(varied: Sequence[Variation]) -> list[tuple[str, ...]]:
    """Return the changes of the configuration for each point of the grid."""
    return list(product(*(each.changes for each in varied)))


def require_evaluated(config: Config) -> None:
    """Raise ValueError if a run has no evaluation return."""
    training = config.training
    good = 0 < training.evaluate_every <= training.iterations
    require(
        good, "evaluate_every", f"1 to {training.iterations}, since results need evaluations", training.evaluate_every
    )


class Outcome(NamedTuple):
    """Result of a run, or medians over several runs.

    Attributes:
        final: last evaluation return.
        best: greatest evaluation return.
        episodes_to: number of exploration episodes until each threshold was reached; infinity if it was not.
    """

    final: float
    best: float
    episodes_to: tuple[float, ...]

    @classmethod
    def of(cls, rows: Sequence[Row], thresholds: Sequence[float]) -> Outcome:
        """Return the result of a run from its curve."""
        evaluated = [row for row in rows if not np.isnan(row.evaluation_return)]
        returns = [row.evaluation_return for row in evaluated]
        reached = (
            next((float(row.episodes) for row in evaluated if row.evaluation_return >= least), inf)
            for least in thresholds
        )
        return cls(returns[-1], max(returns), tuple(reached))

    @classmethod
    def median(cls, outcomes: Sequence[Outcome]) -> Outcome:
        """Return the medians over runs."""
        reached = zip(*(each.episodes_to for each in outcomes), strict=True)
        return cls(
            median(each.final for each in outcomes), median(each.best for each in outcomes), tuple(map(median, reached))
        )


def as_csv(head: Sequence[str], thresholds: Sequence[float], lines: Iterable[tuple[Sequence[object], Outcome]]) -> str:
    """Return a table as CSV with all digits; each line holds its labels and its outcome."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*head, *_columns(thresholds, "_")])
    writer.writerows([*about, *_flat(outcome)] for about, outcome in lines)
    return text.getvalue()


def as_markdown(
    head: Sequence[str], thresholds: Sequence[float], lines: Iterable[tuple[Sequence[object], Outcome]]
) -> str:
    """Return the same table as Markdown with rounded numbers."""
    names = [*head, *_columns(thresholds, " ")]
    body = [[*map(str, about), *(f"{number:.5g}" for number in _flat(outcome))] for about, outcome in lines]
    rows = [names, ["---"] * len(names), *body]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _columns(thresholds: Sequence[float], space: str) -> list[str]:
    names = ["final return", "best return", *(f"episodes to {least:g}" for least in thresholds)]
    return [name.replace(" ", space) for name in names]


def _flat(outcome: Outcome) -> list[float]:
    return [outcome.final, outcome.best, *outcome.episodes_to]


def indexed_folder(folder: Path, config: Config) -> Path:
    """Return the folder of a run within the folder of its study, named by a hash of settings and provenance.

    Args:
        folder: folder of the study.
        config: configuration of the run.
    """
    key = dumped(config.parameters()) + dumped(provenance())
    return folder / "runs" / blake2b(key.encode(), digest_size=12).hexdigest()
