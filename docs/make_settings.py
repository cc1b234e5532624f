"""Writes docs/settings.md, the page of all settings, from what the code says of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rkhs_ros.base.settings import Entry, entries
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.algorithms.step_rules import STEP_RULES
from rkhs_ros.learning.model.model_based import MODELS
from rkhs_ros.learning.training_settings import Training

PAGE = Path(__file__).with_name("settings.md")
CHOICES = ("algorithm.name", "model.form")
FAR = 1e9  # a bound as far away only keeps out what is no number
HEAD = """\
# Settings

<!-- Made by docs/make_settings.py from the code; do not edit. -->

All settings of the learner by their dotted names, as they stand in the `config.yaml` of a run and in the files of
`config/`, and are given to `--set` on the command line. They are the learner's ROS parameters, too. Where a list of
numbers is expected, a single number will do. What is unknown, of another type or out of its range is refused in one
line. The task is set by `environment.id` and `environment.options`, see [tasks](custom_task.md).
"""
TABLE = "| Setting | Default | What it is | Values |\n|---|---|---|---|"


def page() -> str:
    """Return the page."""
    training = list(entries(Training()))
    sections = [
        section("## Run", "What the learner does, whatever the algorithm.", apart(training, "")),
        section("## Inputs", "What the policy is given of observations and actions.", apart(training, "inputs.")),
        section("## Kernel", "The space in which the policy's mean is looked for.", apart(training, "kernel.")),
        f"## Algorithms\n\nOne of them is `algorithm.name`: {names(ALGORITHMS)}. Their mathematics and "
        "their code: [algorithms](algorithms/index.md).\n",
        *of_classes(ALGORITHMS, "algorithm."),
        f"## Step rules\n\nOne of them is `algorithm.step.rule`: {names(STEP_RULES)}.\n",
        *of_classes(STEP_RULES, "algorithm.step."),
        f"## Model\n\nOne of them is `model.form`: {names(MODELS)}. What it is good for: "
        "[model-based training](model_based.md).\n",
        *of_classes(MODELS, "model."),
    ]
    return "\n".join([HEAD, *sections])


def is_up_to_date() -> bool:
    """Return whether the page is what the code says."""
    return PAGE.is_file() and PAGE.read_text() == page()


def apart(settings: Iterable[Entry], prefix: str) -> list[Entry]:
    """Return the settings under a prefix; those under none, with what is chosen by name, for an empty one."""
    if prefix:
        return [entry for entry in settings if entry.name.startswith(prefix)]
    return [entry for entry in settings if "." not in entry.name or entry.name in CHOICES]


def of_classes(table: Mapping[str, type], prefix: str) -> list[str]:
    """Return a section for each class of settings."""
    return [section(f"### `{name}`", first_line(cls), entries(cls(), prefix)) for name, cls in table.items()]


def section(title: str, about: str, settings: Iterable[Entry]) -> str:
    """Return a heading, a sentence and the table of some settings; no table of none."""
    rows = [row(entry) for entry in settings]
    return "\n".join([f"{title}\n\n{about}\n", *([TABLE, *rows, ""] if rows else [])])


def row(entry: Entry) -> str:
    """Return the line of a setting."""
    description = entry.about["description"].replace("|", "\\|")
    return f"| `{entry.name}` | `{text(entry.value)}` | {description} | {values(entry.about)} |"


def values(about: Mapping[str, Any]) -> str:
    """Return the numbers and words that a setting may be."""
    low, high = about["minimum"], about["maximum"]
    bounds = [
        f"at least {text(low)}" if low is not None and low > -FAR else "",
        f"at most {text(high)}" if high is not None and high < FAR else "",
    ]
    numbers = f"{text(low)} to {text(high)}" if all(bounds) else "".join(bounds)
    return ", or ".join(part for part in (numbers, names(about["choices"])) if part)


def names(words: Iterable[str]) -> str:
    """Return words as code, with commas between them."""
    return ", ".join(f"`{word}`" for word in words)


def text(value: Any) -> str:
    """Return a value as one would write it in YAML."""
    if isinstance(value, tuple):
        return "[" + ", ".join(map(text, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def first_line(cls: type) -> str:
    """Return the first line of a class's docstring, in Markdown."""
    return re.sub(":math:`(.+?)`", r"$\1$", (cls.__doc__ or "").partition("\n")[0])


if __name__ == "__main__":
    PAGE.write_text(page())
