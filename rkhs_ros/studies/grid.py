"""Grid of settings, and the results of the runs at its points."""

import json
from collections.abc import Iterable, Mapping, Sequence
from hashlib import blake2b
from itertools import product
from math import inf
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import dumped, loaded
from rkhs_ros.learning.iteration import Row
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.report import provenance_lines

OF_THE_TASK = ("horizon", "discount")  # and the environment; returns of different tasks are not comparable
OF_THE_COUNT = ("seed", "name", "timeout")  # do not change how a run learns


def parse_variations(texts: Iterable[str]) -> dict[str, list[Any]]:
    """Return the values of each varied setting from texts such as ``algorithm.ridge=1e-3,1e-2``, whose values are YAML.

    Raises:
        ValueError: a text is not ``KEY=VALUE,VALUE ...``, a setting makes the returns incomparable, or a setting or a
            value is given twice.
    """
    varied: dict[str, list[Any]] = {}
    for text in texts:
        name, equals, values = (part.strip() for part in text.partition("="))
        require(bool(name and equals and values), "--vary", "KEY=VALUE,VALUE ...", f"'{text}'")
        require(name not in varied, "--vary", "each setting once", name)
        require(name not in OF_THE_COUNT, "--vary", "settings of the learner (use --seeds for seeds)", name)
        same_task = name not in OF_THE_TASK and not name.startswith("environment")
        require(same_task, "--vary", "settings that do not change the task, so that the returns are comparable", name)
        try:
            varied[name] = loaded(f"[{values}]")
        except ValueError as error:
            raise ValueError(f"--vary: expected values in YAML, got '{text}'") from error
        distinct = set(map(json.dumps, varied[name]))
        require(len(distinct) == len(varied[name]), f"--vary: {name}", "distinct values", values)
    return varied


def points(varied: Mapping[str, Sequence[Any]]) -> list[tuple[str, ...]]:
    """Return the changes of the configuration for each point of the grid."""
    return list(product(*([f"{name}={json.dumps(each)}" for each in values] for name, values in varied.items())))


def require_evaluated(config: Config) -> None:
    """Raise ValueError if a run has no evaluation return."""
    training = config.training
    good = 0 < training.evaluate_every <= training.iterations
    require(
        good, "evaluate_every", f"1 to {training.iterations}, since results need evaluations", training.evaluate_every
    )


def outcome(rows: Sequence[Row], thresholds: Sequence[float]) -> dict[str, float]:
    """Return the result of a run: its last and its greatest evaluation return, and the episodes to each threshold.

    The number of exploration episodes to a threshold that was never reached is infinite.
    """
    evaluated = [row for row in rows if not np.isnan(row.evaluation_return)]
    returns = [row.evaluation_return for row in evaluated]
    reached = {least: [row.episodes for row in evaluated if row.evaluation_return >= least] for least in thresholds}
    episodes = {f"episodes_to_{least:g}": float(some[0]) if some else inf for least, some in reached.items()}
    return {"final_return": returns[-1], "best_return": max(returns), **episodes}


def medians(outcomes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the medians of the results of several runs."""
    return {name: median(each[name] for each in outcomes) for name in outcomes[0]}


def indexed_folder(folder: Path, config: Config) -> Path:
    """Return the folder of a run within the folder of its study, named by a hash of settings and provenance."""
    key = dumped(config.parameters()) + repr(provenance_lines())
    return folder / "runs" / blake2b(key.encode(), digest_size=12).hexdigest()
