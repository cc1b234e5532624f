"""Results of a run in its folder: configuration, learning curve and policy."""

import platform
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import version
from math import inf, isnan
from pathlib import Path
from shlex import quote

from rkhs_ros import __version__
from rkhs_ros.base.files import DOMAIN_FILE, is_locked, write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.learning.iteration import Iteration, Row, with_error
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import load_policy, save_policy
from rkhs_ros.rollouts.evaluation import FinalEvaluation
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve, columns, evaluation_errors

LIBRARIES = {name: version(name) for name in ("numpy", "scipy")}
CONFIGURATION = "config.yaml"
ADVICE = "advice.txt"  # one line for each sign that the run does not learn
BEST_POLICY = "best_policy.npz"
INITIAL_POLICY = "initial_policy.npz"
FINAL_EVALUATION = "final_evaluation.txt"
# Files that may be left by a run that was killed before it started.
BEFORE_A_RUN = {
    *("initial_policy.npz", "initial_policy.npz.part", "config.yaml.part"),
    *(DOMAIN_FILE, "lock", "parameters.yaml", "parameters.yaml.part"),
}


def new_folder(folder: Path | None, name: str) -> Path:
    """Create the folder of a run, or raise ValueError if it is in use; None stands for results/NAME/TIME."""
    if folder is None:
        folder = Path("results") / name / datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")
    if folder.exists() and (not folder.is_dir() or {path.name for path in folder.iterdir()} - BEFORE_A_RUN):
        raise ValueError(f"{folder}: expected a new or empty folder for the results, got one in use. Choose another")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def is_started(folder: Path) -> bool:
    """Return whether a run was started in the folder."""
    return (folder / CONFIGURATION).is_file()


def old_folder(folder: Path | None) -> Path:
    """Return the folder of a run, or raise ValueError if none was started in it."""
    if folder is not None and not folder.exists():
        raise ValueError(f"{folder}: expected the folder of a run, got no such folder")
    if folder is None or not is_started(folder):
        runs = sorted(file.parent for file in folder.glob("*/config.yaml")) if folder else []
        remedy = f". Pass one of the runs in it, such as {runs[0]}" if runs else ""
        raise ValueError(f"{folder}: expected the folder of a run, got none with a config.yaml{remedy}")
    return folder


def last_policy(folder: Path) -> Path:
    """Return the file of the last policy of a run; of an unfinished run, the best policy so far, with a note.

    Raises:
        ValueError: there is no policy yet, or the folder is not that of a run.
    """
    file, best = folder / "policy.npz", folder / BEST_POLICY
    if file.is_file():
        return file
    old_folder(folder)
    remedy = f"Continue with: rkhs train --resume {folder}"
    if best.is_file():
        print(f"note: {folder}: the run has not finished; using its best policy so far. {remedy}", file=sys.stderr)
        return best
    raise ValueError(f"{file}: expected a policy, got none since the run has not finished. {remedy}")


class Report:
    """Results of a run, written while it runs.

    Owns the files of the folder except the recording. config.yaml is written at the start; curve.csv and
    advice.txt grow with the run. best_policy.npz holds the
    policy with the greatest evaluation return minus its standard error, which `decide` may replace by the last policy.
    `finish` writes policy.npz.

    Args:
        folder: an empty folder, or the folder of the run that resumes.
        policies: policies after these iterations.

    Attributes:
        rows: the rows of the learning curve so far.
        best_policy: the policy of best_policy.npz; None before the first evaluation.
        final: the evaluation at the end of the run, if there was one.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        spaces: Spaces,
        rows: Sequence[Row] = (),
        policies: Sequence[GaussianPolicy] = (),
    ) -> None:
        self.folder = folder
        self._config = config
        self._curve = Curve(folder / "curve.csv")
        self._last: Iteration | None = None
        self._spaces = spaces
        self.final: FinalEvaluation | None = None
        self.rows = list(rows)
        bounds = evaluation_bounds(self.rows)
        self._best = max(bounds, default=-inf)
        self.best_policy = policies[bounds.index(self._best)] if self._best > -inf else None
        final, best = folder / FINAL_EVALUATION, folder / BEST_POLICY
        final.unlink(missing_ok=True)  # of a finished run, which continues
        if self.best_policy is None:
            best.unlink(missing_ok=True)
        else:
            self._save(BEST_POLICY, self.best_policy)
        self._began = time.monotonic() - (self.rows[-1].seconds if self.rows else 0.0)
        begin(folder, config)
        self._curve.begin(self.rows)

    def add(self, iteration: Iteration) -> None:
        """Write the line of an iteration, and its policy if its `evaluation_bound` is the greatest so far."""
        row = iteration.row(time.monotonic() - self._began)
        self._curve.append(row)
        self.rows.append(row)
        if iteration.evaluation_bound > self._best:
            self._best, self.best_policy = iteration.evaluation_bound, iteration.policy
            self._save(BEST_POLICY, iteration.policy)
        self._last = iteration

    def decide(self, final: FinalEvaluation) -> None:
        """Write final_evaluation.txt, and the last policy as best_policy.npz if it is better in fresh episodes."""
        self.final = final
        if final.last_is_better and self._last is not None:
            self.best_policy = self._last.policy
            self._save(BEST_POLICY, self.best_policy)
        write_whole(self.folder / FINAL_EVALUATION, f"{final}\n".encode())

    def _save(self, name: str, policy: GaussianPolicy) -> None:
        save_policy(self.folder / name, policy, self._config.task, self._spaces)

    def advise(self, advice: str) -> None:
        """Append a line to advice.txt."""
        write_whole(self.folder / ADVICE, "".join(f"{line}\n" for line in [*advice_in(self.folder), advice]).encode())

    def finish(self) -> None:
        """Write the last policy."""
        if self._last is not None:
            self._save("policy.npz", self._last.policy)


def advice_in(folder: Path) -> list[str]:
    """Return the lines of advice.txt, none if the file does not exist or cannot be read."""
    try:
        return (folder / ADVICE).read_bytes().decode(errors="replace").splitlines()
    except (OSError, ValueError):
        return []


def begin(folder: Path, config: Config) -> None:
    """Write the configuration of a run, which makes the run resumable."""
    write_whole(folder / CONFIGURATION, resolved(config).encode())


def start_from(folder: Path, config: Config, policy: GaussianPolicy | None, spaces: Spaces) -> None:
    """Prepare the folder of a run that has not started: with an initial policy, or None for the default.

    Raises:
        ValueError: the nodes of another run in the folder are starting.
    """
    require(not is_locked(folder, DOMAIN_FILE), f"{folder}", "a folder that no other run uses", "one whose nodes start")
    file = folder / INITIAL_POLICY
    file.unlink(missing_ok=True)  # left by a run that was killed before it started
    if policy is not None:
        save_policy(file, policy, config.task, spaces)


def initial_policy(folder: Path) -> GaussianPolicy | None:
    """Return the policy that a run was given to begin with, if any."""
    file = folder / INITIAL_POLICY
    return load_policy(file)[0] if file.exists() else None


def provenance_lines() -> tuple[str, ...]:
    """Return the versions on which the results of a run depend, "name version" each."""
    versions = {"Python": platform.python_version(), "rkhs_ros": __version__, **LIBRARIES}
    return tuple(f"{name} {each}" for name, each in versions.items())


def resolved(config: Config) -> str:
    """Return the whole configuration as a ROS parameter file, with the current versions in a comment at the top."""
    return f"# {', '.join(provenance_lines())}\n{dumped(config.parameters())}"


def evaluation_bounds(rows: Sequence[Row]) -> list[float]:
    """Return each evaluation return of a whole curve minus its standard error; minus infinity without an evaluation."""
    curve = columns(rows)
    bounds = (curve["evaluation_return"] - evaluation_errors(curve)).tolist()
    return [-inf if isnan(bound) else bound for bound in bounds]


def summary(folder: Path, config: Config) -> str:
    """Return a summary of a finished run: episodes, time, returns and files."""
    rows = Curve(folder / "curve.csv").rows()
    last = rows[-1]
    evaluations = f" and {last.evaluation_episodes} evaluation episodes" if last.evaluation_episodes else ""
    final = folder / FINAL_EVALUATION
    lines = [
        f"Trained on {config.environment.id} for {last.episodes} episodes{evaluations} in {last.seconds:.1f} s, "
        f"with {last.steps} steps of experience.",
        f"Discounted return: {_returns(rows)}; {len(load_policy(folder / 'policy.npz')[0].mean.centres)} centres.",
        *([f"Final evaluation: {final.read_bytes().decode().strip()}."] if final.is_file() else []),
        f"Pictures: {folder / 'curve.png'} and {folder / 'policy.png'}",
        next_steps(folder, config),
    ]
    return "\n".join(lines)


def _returns(rows: list[Row]) -> str:
    """Describe the evaluation returns with their standard errors, or else the exploration returns."""
    errors, bounds = evaluation_errors(columns(rows)), evaluation_bounds(rows)
    evaluated = [number for number, row in enumerate(rows) if not isnan(row.evaluation_return)]
    if not evaluated:
        return f"{rows[0].exploration_return:.4g} in the first iteration, {rows[-1].exploration_return:.4g} in the last"
    first, last, best = (
        f"{with_error(rows[at].evaluation_return, errors[at])} after episode {rows[at].episodes}"
        for at in (evaluated[0], evaluated[-1], bounds.index(max(bounds)))
    )
    undiscounted = f"undiscounted {rows[evaluated[-1]].undiscounted_evaluation_return:.4g}"
    return f"{first}, {last} ({undiscounted}), at best {best}"


def interruption_summary(folder: Path, config: Config) -> str:
    """Return the progress of an interrupted run, its saved files, and the command that resumes it, in one line."""
    done = len(Curve(folder / "curve.csv").rows())
    saved = [str(folder / name) for name in ("curve.csv", "policy.npz") if (folder / name).is_file()]
    return (
        f"interrupted after {done} of {config.training.iterations} iterations; saved: {', '.join(saved) or 'nothing'}; "
        f"{resume_hint(folder, config)}"
    )


def next_steps(folder: Path, config: Config) -> str:
    """Return the folder of a finished run, and the commands that show, measure and continue it."""
    name, longer = quote(str(folder)), 2 * config.training.iterations
    named = f"{name}{_environment(config)}"
    commands = f"view: rkhs view {named}; measure: rkhs evaluate {named}"
    return f"Results: {name}; {commands}; continue: rkhs train --resume {named} --iterations {longer}"


def resume_hint(folder: Path, config: Config) -> str:
    """Return the command that resumes a run."""
    return f"resume with: rkhs train --resume {quote(str(folder))}{_environment(config)}"


def _environment(config: Config) -> str:
    """Return the option that names the environment of a run, if that names its module."""
    environment = config.environment.id
    return f" --env {quote(environment)}" if ":" in environment else ""
