"""Describe the progress of a run."""

from collections.abc import Sequence
from math import isnan

from rkhs_ros.learning.iteration import Row
from rkhs_ros.runs.curve import seconds_left
from rkhs_ros.runs.report import advice_in
from rkhs_ros.view.recorded import RUNNING, Recorded


def status(source: Recorded, state: str) -> str:
    """Return the progress of a run as Markdown."""
    rows = source.rows
    lines = [f"### {state.capitalize()}: iteration {rows[-1].iteration if rows else 0} of {source.total}"]
    if rows:
        last = rows[-1]
        counts = {"episode": last.episodes, "step": last.steps, "centre": last.centres}
        sizes = ", ".join(counted(count, what) for what, count in counts.items() if count)
        lines.append(f"{sizes}, {clock(last.seconds)}{left(source, state)}")
        lines.append(f"Return: exploration **{last.exploration_return:.4g}**{measured(rows)}")
    lines += [f"**Note**: {advice}" for advice in advice_in(source.path)]
    what = f"`{source.task.environment}` in " * bool(source.task.environment)
    return "\n\n".join([*lines, f"{what}`{source.path}`"])


def measured(rows: Sequence[Row]) -> str:
    """Return the last evaluation return and model return, if there are any, as text."""
    evaluation = next((row.evaluation_return for row in reversed(rows) if not isnan(row.evaluation_return)), None)
    model = rows[-1].model_return
    text = "" if evaluation is None else f", evaluation **{evaluation:.4g}**"
    return text + ("" if isnan(model) else f", model rollouts {model:.4g}")


def left(source: Recorded, state: str) -> str:
    """Return the remaining time of a run, estimated from its last iterations; empty if it is not running."""
    seconds = seconds_left(source.rows, source.total) if state == RUNNING else float("nan")
    return "" if isnan(seconds) else f", about {clock(seconds)} left"


def counted(number: int, what: str) -> str:
    """Return a number with its noun, such as "3 episodes"."""
    return f"{number} {what}{'s' * (number != 1)}"


def clock(seconds: float) -> str:
    """Return a duration in rounded units, such as "5 h 33 min"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
