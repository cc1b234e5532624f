"""Search space of settings, derived from the ranges of the settings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite

from rkhs_ros.base.settings import Entry, check_range, entries, unused
from rkhs_ros.base.validation import pick, require, truncated
from rkhs_ros.runs.config import Config
from rkhs_ros.studies.grid import require_comparable

SPREAD = 30.0  # a range of many decades is limited to this factor below and above the setting's value
LARGE = 1e5  # a value from here on means that there is no bound
SEARCHED = ("algorithm.", "kernel.", "model.", "exploration_sd")
# Larger values of these cost time or real episodes, and never lower the return; they are searched only if named.
ONLY_NAMED = ("algorithm.centres", "algorithm.grid_counts", "algorithm.step.choices", "algorithm.step.episodes")
OF_THE_BUDGET = ("iterations", "episodes_per_iteration", "evaluate_every", "evaluation_episodes")


@dataclass(frozen=True)
class Dimension:
    """A setting to search, within a range or among choices.

    Attributes:
        name: dotted name of the setting.
        low: least value.
        high: greatest value.
        is_whole: whether the value is a whole number.
        choices: choices instead of a range.
    """

    name: str
    low: float = 0.0
    high: float = 0.0
    is_whole: bool = False
    choices: tuple[str, ...] = ()

    @property
    def is_log(self) -> bool:
        """Whether the range spans a decade or more, so that the search uses a logarithmic scale."""
        return 0.0 < 10.0 * self.low <= self.high

    def __str__(self) -> str:
        """Return the dimension as text."""
        if self.choices:
            return f"{self.name} among {', '.join(self.choices)}"
        return f"{self.name} in [{self.low:g}, {self.high:g}]{', by logarithms' * self.is_log}"


def search_space(config: Config, over: Iterable[str]) -> tuple[Dimension, ...]:
    """Return the settings to search, with their ranges or choices.

    Args:
        config: configuration with the initial settings.
        over: names of settings, each optionally with a range or choices, such as ``algorithm.ridge=1e-4:1`` or
            ``algorithm.critic=step,trajectory``; if empty, all numbers in effect of the algorithm, kernel and model.

    Raises:
        ValueError: a setting is unknown, cannot be searched or has no range, or a range exceeds the setting's range.
    """
    known = {entry.name: entry for entry in entries(config.training)}
    texts = list(over)
    if not texts:
        idle = {*ONLY_NAMED, *unused(config.training)}
        found = (_own(entry) for name, entry in known.items() if name.startswith(SEARCHED) and name not in idle)
        return tuple(each for each in found if each is not None and not each.choices)
    names = [text.partition("=")[0] for text in texts]
    require(len(set(names)) == len(names), "--over", "each setting once", " ".join(names))
    return tuple(_named(text, known) for text in texts)


def _named(text: str, known: dict[str, Entry]) -> Dimension:
    name, equals, wanted = text.partition("=")
    entry = pick(name, known, "setting")
    require_comparable(name, "--over")
    require(name not in OF_THE_BUDGET, "--over", "settings of the learner", f"{name}, which sets the length of a run")
    if not equals:
        own = _own(entry)
        if own is None:
            raise ValueError(
                f"--over: {name}: expected a range, such as {name}=LOW:HIGH, got none for {truncated(entry.value)}"
            )
        return own
    if isinstance(entry.value, str) and ":" in wanted:
        expected = f"choices, because the configured value is '{entry.value}' (to search a range, --set a number first)"
        require(False, f"--over: {name}", expected, f"the range {truncated(wanted)}")
    return _of_choices(entry, wanted.split(",")) if isinstance(entry.value, str) else _of_range(entry, wanted)


def _own(entry: Entry) -> Dimension | None:
    """Return the dimension of a setting from its range; None if the range is not sufficient."""
    name, value, about = entry
    if isinstance(value, str):
        is_choice = value in about["choices"] and len(about["choices"]) > 1
        return Dimension(name, choices=about["choices"]) if is_choice else None
    number, low, high = _number(value), about["minimum"], about["maximum"]
    if number is None or low is None or high is None:
        return None
    if high - low <= 1.0 or (low > 0.0 and high < 10.0 * low):
        return Dimension(name, low, high, type(value) is int)
    if not 0.0 < number < LARGE:
        return None
    least, most = max(low, number / SPREAD), min(high, number * SPREAD)
    return Dimension(name, *((round(least), round(most)) if type(value) is int else (least, most)), type(value) is int)


def _number(value: object) -> float | None:
    """Return the number of a setting; None if it is a list of several numbers."""
    values = value if isinstance(value, tuple) else (value,)
    return float(values[0]) if len(values) == 1 else None


def _of_choices(entry: Entry, choices: list[str]) -> Dimension:
    for choice in choices:
        check_range(choice, entry.about, f"--over: {entry.name}")
    require(
        entry.value in choices,
        f"--over: {entry.name}",
        f"choices that include its value '{entry.value}'",
        ",".join(choices),
    )
    return Dimension(entry.name, choices=tuple(choices))


def _of_range(entry: Entry, text: str) -> Dimension:
    what, value = f"--over: {entry.name}", _number(entry.value)
    try:
        low, high = map(float, text.split(":"))
    except ValueError as error:
        raise ValueError(f"{what}: expected a range LOW:HIGH, got '{truncated(text)}'") from error
    for bound in (low, high):
        check_range(bound, entry.about, what)
    is_whole = type(entry.value) is int
    whole = not is_whole or (low == int(low) and high == int(high))
    require(whole and isfinite(low) and low < high, what, f"{'whole' * is_whole} numbers LOW < HIGH".strip(), text)
    good = value is not None and low <= value <= high
    require(good, what, "a range that includes the initial value", entry.value)
    return Dimension(entry.name, low, high, is_whole)
