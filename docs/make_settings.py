"""Write docs/settings.md, the reference of all settings, from their declarations in the code."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rkhs_ros.base.settings import Entry, build, entries
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.algorithms.step_rules import STEP_RULES
from rkhs_ros.learning.training_settings import MODELS, Training
from rkhs_ros.runs.defaults import settings_for

PAGE = Path(__file__).with_name("settings.md")
CHOICES = ("algorithm.name", "model.form")
FAR = 1e9  # a bound this far away only rejects infinity and nan
HEAD = """\
# Settings

<!-- Made by docs/make_settings.py from the code; do not edit. -->

This page lists all settings of the learner by their dotted names. Use these names in the files of `config/`, after
`--set` on the command line, and as ROS parameters of the learner node. The `config.yaml` of a run contains all
of their values.

A setting that takes a list of numbers also accepts a single number. A setting that is unknown, has the wrong type or is
out of range is rejected with a one-line error. `environment.id` and `environment.options` select the task: see
[a custom task](custom_task.md).
"""
TABLE = "| Setting | Default | Description | Values |\n|---|---|---|---|"
SHARED_TABLE = "| Setting | Description | Values |\n|---|---|---|"


def page() -> str:
    """Return the page."""
    training = list(entries(Training()))
    sections = [
        section("## Run", "Settings of all runs, for any algorithm.", apart(training, "")),
        section(
            "## Inputs", "The inputs of the policy, computed from observations and actions.", apart(training, "inputs.")
        ),
        section("## Kernel", "The kernel of the policy mean.", apart(training, "kernel.")),
        f"## Algorithms\n\n`algorithm.name` selects one: {names(ALGORITHMS)}. For their mathematics, "
        "see [algorithms](algorithms/index.md).\n",
        *of_algorithms(),
        f"## Step rules\n\n`algorithm.step.rule` selects one: {names(STEP_RULES)}.\n",
        *of_classes(STEP_RULES, "algorithm.step."),
        f"## Model\n\n`model.form` selects one: {names(MODELS)}. For when to use a model, "
        "see [model-based training](model_based.md).\n\n"
        f"With `none` and `rkhs_nac`, the library and `rkhs train --env` have other defaults: {without_model()}.\n",
        *of_classes(MODELS, "model."),
    ]
    return "\n".join([HEAD, *sections])


def without_model() -> str:
    """Return the defaults that differ without a model."""
    with_model = {entry.name: entry.value for entry in entries(Training())}
    others = entries(build(Training, settings_for(model="none")))
    differ = (entry for entry in others if with_model.get(entry.name) not in (None, entry.value))
    return ", ".join(f"`{entry.name}` `{text(entry.value)}`" for entry in differ if entry.name != "model.form")


def is_up_to_date() -> bool:
    """Return whether the page agrees with the code."""
    return PAGE.is_file() and PAGE.read_text() == page()


def apart(settings: Iterable[Entry], prefix: str) -> list[Entry]:
    """Return the settings under a prefix; for an empty prefix, those without one and the choices by name."""
    if prefix:
        return [entry for entry in settings if entry.name.startswith(prefix)]
    return [entry for entry in settings if "." not in entry.name or entry.name in CHOICES]


def of_classes(table: Mapping[str, type], prefix: str) -> list[str]:
    """Return a section for each class of settings."""
    return [section(f"### `{name}`", first_line(cls), entries(cls(), prefix)) for name, cls in table.items()]


def of_algorithms() -> list[str]:
    """Return a table of the settings that several algorithms share, and a section for each algorithm."""
    found = {name: list(entries(cls(), "algorithm.")) for name, cls in ALGORITHMS.items()}
    count = Counter(about(entry) for each in found.values() for entry in each)
    best = {key[0]: key for key in sorted(count, key=lambda key: count[key])}  # the most common meaning of each name
    shared = [key for key in count if key == best[key[0]] and count[key] > 1]
    table = [
        "Several algorithms share these settings:\n",
        SHARED_TABLE,
        *(" | ".join(["", *key, ""]).strip() for key in shared),
        "",
    ]
    sections = []
    for name, each in found.items():
        own = [entry for entry in each if about(entry) not in shared]
        defaults = [f"`{entry.name}` `{text(entry.value)}`" for entry in each if entry not in own]
        title, line = f"### `{name}`", first_line(ALGORITHMS[name])
        sections += [section(title, f"{line}\n\nShared settings and their defaults: {', '.join(defaults)}.", own)]
    return ["\n".join(table), *sections]


def about(entry: Entry) -> tuple[str, str, str]:
    """Return the name, description and values of a setting, as cells of a table."""
    return f"`{entry.name}`", entry.about["description"].replace("|", "\\|"), values(entry.about)


def section(title: str, about: str, settings: Iterable[Entry]) -> str:
    """Return a heading, a sentence and a table of settings, without the table if there are none."""
    rows = [row(entry) for entry in settings]
    return "\n".join([f"{title}\n\n{about}\n", *([TABLE, *rows, ""] if rows else [])])


def row(entry: Entry) -> str:
    """Return the line of a setting."""
    name, description, allowed = about(entry)
    return f"| {name} | `{text(entry.value)}` | {description} | {allowed} |"


def values(about: Mapping[str, Any]) -> str:
    """Return the range of a setting and its choices."""
    low, high = about["minimum"], about["maximum"]
    bounds = [
        f"at least {text(low)}" if low is not None and low > -FAR else "",
        f"at most {text(high)}" if high is not None and high < FAR else "",
    ]
    numbers = f"{text(low)} to {text(high)}" if all(bounds) else "".join(bounds)
    return ", or ".join(part for part in (numbers, names(about["choices"])) if part)


def names(words: Iterable[str]) -> str:
    """Return words in code format, separated by commas."""
    return ", ".join(f"`{word}`" for word in words)


def text(value: Any) -> str:
    """Return a value in YAML."""
    if isinstance(value, tuple):
        return "[" + ", ".join(map(text, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value) or "''"


def first_line(cls: type) -> str:
    """Return the first line of a class's docstring, in Markdown."""
    return re.sub(":math:`(.+?)`", r"$\1$", (cls.__doc__ or "").partition("\n")[0])


if __name__ == "__main__":
    PAGE.write_text(page())
