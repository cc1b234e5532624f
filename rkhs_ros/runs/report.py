"""What a run leaves in its folder: configuration, learning curve, policy and episodes."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Iterable
from datetime import datetime
from itertools import takewhile
from math import inf, isnan
from pathlib import Path
from shlex import quote

from rkhs_ros.base.endings import error_message
from rkhs_ros.base.files import read_whole, write_whole
from rkhs_ros.base.user_code import is_installed
from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.learning.training import Iteration
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import read_policy, save_policy
from rkhs_ros.runs.attempts import Attempts
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve, Row
from rkhs_ros.runs.episode_files import save_episodes
from rkhs_ros.runs.provenance import provenance_lines

CONFIGURATION = "config.yaml"
BEST_POLICY = "best_policy.npz"
FIRST_POLICY = "first_policy.npz"  # of a run that began from a given policy
MOST_RECENT = 256  # lines of the curve that are at hand for those who look on
RAW = "raw.mcap"  # of the recorder node, which begins before the learner
BEFORE_A_RUN = {
    "checkpoints",
    "config.yaml.part",
    FIRST_POLICY,
    RAW,
    f"{RAW}.part",
}  # what a run killed before it began may leave


def new_folder(folder: Path | None, name: str) -> Path:
    """Make the folder of a run, results/NAME/TIME where None is given.

    Raises:
        ValueError: it holds something already.
        OSError: it cannot be made.
    """
    if folder is None:
        folder = Path("results") / name / datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")
    if folder.exists() and (not folder.is_dir() or {path.name for path in folder.iterdir()} - BEFORE_A_RUN):
        raise ValueError(f"{folder}: expected a new or empty folder for the results, got one in use; choose another")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def is_begun(folder: Path) -> bool:
    """Return whether a run was begun in the folder."""
    return (folder / CONFIGURATION).is_file()


def old_folder(folder: Path | None) -> Path:
    """Return the folder of a run that was begun.

    Raises:
        ValueError: there is no config.yaml in it, or no folder.
    """
    if folder is None or not is_begun(folder):
        runs = sorted(file.parent for file in folder.glob("*/config.yaml")) if folder else []
        remedy = f"; name one of those in it, as {runs[0]}" if runs else ""
        raise ValueError(f"{folder}: expected the folder of a run, got none with a config.yaml{remedy}")
    return folder


def last_policy(folder: Path) -> Path:
    """Return the file of the last policy of a run that came to an end.

    Raises:
        ValueError: there is none yet, or the folder is none of a run.
    """
    file = folder / "policy.npz"
    if file.is_file():
        return file
    old_folder(folder)
    best = folder / BEST_POLICY
    remedy = f"; the best one so far is {best}" * best.is_file()
    raise ValueError(f"{file}: expected the last policy, got none as the run has not ended{remedy}")


class Report:
    """The results of a run, written as it goes.

    Owns the files of its folder, less the checkpoints: config.yaml is there from the beginning, curve.csv grows with
    the run, and attempts.npz where the task has one step, best_policy.npz is the policy of its greatest noise-free
    return, policy.npz and episodes.npz come with `finish`.

    Args:
        folder: an empty folder, or that of the run that goes on.
        config: the run.
        spaces: of its task.
        done: number of iterations whose lines are kept.

    Attributes:
        recent: the last lines of the learning curve.

    Raises:
        OSError: the folder cannot be written.
    """

    def __init__(self, folder: Path, config: Config, spaces: Spaces, done: int = 0) -> None:
        self.folder = folder
        self._config = config
        self._curve = Curve(folder / "curve.csv")
        self._last: Iteration | None = None
        self._spaces = spaces
        rows = self._curve.rows()[:done]
        self.recent = deque(rows, MOST_RECENT)
        self._best = self._best_of(rows)
        self._attempts = Attempts(folder, config.task, spaces, rows[-1].episodes if rows else 0)
        self._began = time.monotonic() - (rows[-1].seconds if rows else 0.0)
        file = folder / CONFIGURATION
        write_whole(file, _noted(file, resolved(config), done).encode())
        self._curve.begin(rows)

    def add(self, iteration: Iteration) -> None:
        """Write an iteration's line.

        Raises:
            OSError: it cannot be written.
        """
        row = Row.of(iteration, time.monotonic() - self._began)
        self._curve.append(row)
        self.recent.append(row)
        self._attempts.add(iteration.exploration)
        self._keep_best(iteration)
        self._last = iteration

    def _best_of(self, rows: list[Row]) -> float:
        """Return the return of best_policy.npz; minus infinity where it is damaged or missing, which is said."""
        best = best_return(rows)
        if best == -inf:
            return best
        try:
            read_policy(self.folder / BEST_POLICY)
        except (ValueError, OSError) as error:
            print(
                f"warning: {error_message(error)}; the best policy of the iterations to come replaces it",
                file=sys.stderr,
            )
            return -inf
        return best

    def _keep_best(self, iteration: Iteration) -> None:
        """Write the policy beside the last one if it earned more than all before it."""
        if iteration.evaluation_return > self._best:
            self._best = iteration.evaluation_return
            save_policy(self.folder / BEST_POLICY, iteration.policy, self._config.task, self._spaces)

    def finish(self) -> None:
        """Write the policy learnt so far, and its last evaluation episodes, or exploring ones where there are none.

        Raises:
            OSError: one cannot be written.
        """
        if self._last is None:
            return
        save_policy(self.folder / "policy.npz", self._last.policy, self._config.task, self._spaces)
        shown = self._last.evaluation if len(self._last.evaluation) else self._last.exploration
        save_episodes(self.folder / "episodes.npz", shown, self._config.task)


def begin(folder: Path, config: Config) -> None:
    """Write the configuration of a run, which makes its folder one to go on with.

    Raises:
        OSError: it cannot be written.
    """
    write_whole(folder / CONFIGURATION, resolved(config).encode())


def resolved(config: Config) -> str:
    """Return the whole configuration as a ROS parameter file, under the versions it runs with."""
    return f"# {', '.join(provenance_lines())}\n{dumped(config.parameters())}"


def _noted(file: Path, content: str, done: int) -> str:
    """Return what a configuration's file is to hold: with the versions noted in it before, where they are others.

    Args:
        file: of the run so far.
        content: under the versions of now.
        done: number of iterations that are kept.
    """
    lines = read_whole(file).decode(errors="replace").splitlines() if done and file.is_file() else []
    noted = list(takewhile(lambda line: line.startswith("#"), lines))
    now, _, settings = content.partition("\n")
    if not noted or noted[-1].endswith(now.removeprefix("#")):
        return content if len(noted) < 2 else "\n".join([*noted, settings])
    return "\n".join([*noted, f"# from iteration {done + 1}: {now.removeprefix('# ')}", settings])


def best_return(rows: Iterable[Row]) -> float:
    """Return the greatest evaluation return; minus infinity where there was no evaluation."""
    return max((row.evaluation_return for row in rows if not isnan(row.evaluation_return)), default=-inf)


def summary(folder: Path, config: Config) -> str:
    """Return in a few lines what was learnt, what it took, and where it is."""
    rows = Curve(folder / "curve.csv").rows()
    first, last = rows[0], rows[-1]
    evaluations = f", and {last.evaluation_episodes} noise-free ones to measure it" if last.evaluation_episodes else ""
    lines = [
        f"Learnt {config.environment.id} in {_episodes(last.episodes)}{evaluations}, {last.seconds:.1f} s.",
        f"Discounted return: {first.exploration_return:.4g} of the first exploring episodes, {_end(rows)}; "
        f"{last.centres} centres.",
        f"Pictures: {folder / 'curve.png'} and {folder / 'policy.png'}",
        what_next(folder, config),
    ]
    return "\n".join(lines)


def what_was_kept(folder: Path, config: Config) -> str:
    """Return in a line how far an interrupted run came, what it left, and how it goes on."""
    done = len(Curve(folder / "curve.csv").rows())
    kept = [str(folder / name) for name in ("curve.csv", "policy.npz") if (folder / name).is_file()]
    return (
        f"interrupted after {done} of {config.training.iterations} iterations; kept: {', '.join(kept) or 'nothing'}; "
        f"{how_to_go_on(folder, config)}"
    )


def what_next(folder: Path, config: Config) -> str:
    """Return where the results of a run that is done are, and what to type to look at them and to go on."""
    name, longer = quote(str(folder)), 2 * config.training.iterations
    named = f"{name}{_trust(config)}"
    return f"Results: {name}; see them: rkhs view {named}; go on: rkhs train --resume {named} --iterations {longer}"


def how_to_go_on(folder: Path, config: Config) -> str:
    """Return what to type for a run to go on."""
    return f"go on with: rkhs train --resume {quote(str(folder))}{_trust(config)}"


def _trust(config: Config) -> str:
    """Return the option that is needed for a run that names modules which are not installed."""
    return "" if all(map(is_installed, config.modules)) else " --trust"


def _end(rows: list[Row]) -> str:
    best = best_return(rows)
    if best == -inf:
        return f"{rows[-1].exploration_return:.4g} of the last"
    at = next(row for row in rows if row.evaluation_return == best)
    last = next(row for row in reversed(rows) if not isnan(row.evaluation_return))
    end = "at the end" if last is rows[-1] else f"after {_episodes(last.episodes)}"
    kept = "" if at is last else f", {BEST_POLICY}"
    return f"{last.evaluation_return:.4g} noise-free {end}, {best:.4g} at best (after {_episodes(at.episodes)}{kept})"


def _episodes(count: int) -> str:
    return f"{count} episode{'s' * (count != 1)}"
