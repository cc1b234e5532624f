"""Provenance of a run: the versions that ran it, and what it found about its task, in comments of its config.yaml."""

import platform
import re
from collections.abc import Iterable
from importlib.metadata import version
from itertools import takewhile
from pathlib import Path
from shlex import quote

from rkhs_ros import __version__
from rkhs_ros.base.files import read_whole
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.state import Known, settings_of
from rkhs_ros.learning.training_settings import Training

FOUND = re.compile(r"# found in iteration (\d+): .*|# from the initial policy: .*")

LIBRARIES = {name: version(name) for name in ("numpy", "scipy")}


def provenance() -> dict[str, str]:
    """Return the versions on which the results of a run depend, by name."""
    return {"Python": platform.python_version(), "rkhs_ros": __version__, **LIBRARIES}


def provenance_lines() -> tuple[str, ...]:
    """Return the provenance as texts, "name version" each."""
    return tuple(f"{name} {version}" for name, version in provenance().items())


def found_comments(iteration: Iteration, training: Training) -> list[str]:
    """Return comments on what an iteration found about the task, in the form of ``--set``; none if it found nothing.

    For the first iteration, a comment also lists the settings that come from an initial policy.
    """
    of_policy = settings_of(Known.of(training), iteration.before) if iteration.number == 1 else []
    found = settings_of(iteration.before, iteration.known)
    return [
        *([f"# from the initial policy: {_joined(of_policy)}"] if of_policy else []),
        *([f"# found in iteration {iteration.number}: {_joined(found)}"] if found else []),
    ]


def _joined(settings: Iterable[str]) -> str:
    return " ".join(map(quote, settings))


def with_comments(content: str, comments: Iterable[str]) -> str:
    """Return a configuration with further comments after those at its top."""
    earlier = _comments(content)
    return "\n".join([*earlier, *comments, *content.split("\n")[len(earlier) :]])


def resumed(file: Path, content: str, done: int) -> str:
    """Return the content of a configuration file with the comments of a run that resumes.

    A change of code or library versions adds a comment. What iterations after ``done`` found is removed, because the
    run repeats them.

    Args:
        file: configuration file of the run so far.
        content: configuration; its first line is a comment with the current versions.
        done: number of finished iterations.
    """
    earlier = _comments(read_whole(file).decode(errors="replace")) if done and file.is_file() else []
    earlier = [line for line in earlier if _found_in(line) <= done]
    versions = [line for line in earlier if not FOUND.fullmatch(line)]
    now, _, settings = content.partition("\n")
    if not versions:
        return with_comments(content, earlier)
    if not versions[-1].endswith(now.removeprefix("#")):
        earlier.append(f"# from iteration {done + 1}: {now.removeprefix('# ')}")
    return "\n".join([*earlier, settings])


def _comments(content: str) -> list[str]:
    return list(takewhile(lambda line: line.startswith("#"), content.splitlines()))


def _found_in(comment: str) -> int:
    """Return the number of the iteration in a comment on what it found; 0 for other comments."""
    match = FOUND.fullmatch(comment)
    return int(match[1] or 0) if match else 0
