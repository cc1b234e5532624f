"""How far a run is, in words."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

from rkhs_ros.runs.curve import Row, seconds_left
from rkhs_ros.view.source import RUNNING, Source


def status(source: Source, state: str) -> str:
    """Return in Markdown how far a run is."""
    rows = source.rows
    lines = [f"### {state.capitalize()}: iteration {rows[-1].iteration if rows else 0} of {source.total}"]
    if rows:
        last = rows[-1]
        sizes = counted(last.episodes, "episode") + (f", {counted(last.centres, 'centre')}" if last.centres else "")
        lines.append(f"{sizes}, {clock(last.seconds)}{left(source, state)}")
        lines.append(f"Return **{last.exploration_return:.4g}** exploring{measured(rows)}")
    what = f"`{source.task.environment}` in " * bool(source.task.environment)
    return "\n\n".join([*lines, f"{what}`{source.path}`"])


def measured(rows: Sequence[Row]) -> str:
    """Return the last noise-free and model returns in words; nothing of those that there are not."""
    num_evaluation = next((row.evaluation_return for row in reversed(rows) if not isnan(row.evaluation_return)), None)
    imagined = rows[-1].model_return
    text = "" if num_evaluation is None else f", **{num_evaluation:.4g}** noise-free"
    return text + ("" if isnan(imagined) else f", {imagined:.4g} imagined")


def left(source: Source, state: str) -> str:
    """Return how long a run will take still, by the pace of its last iterations; nothing of one not running."""
    seconds = seconds_left(source.rows, source.total) if state == RUNNING else float("nan")
    return "" if isnan(seconds) else f", about {clock(seconds)} left"


def counted(number: int, what: str) -> str:
    """Return a number of things."""
    return f"{number} {what}{'s' * (number != 1)}"


def clock(seconds: float) -> str:
    """Return a time as people say it."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
