"""``rkhs publish``: write a folder with the policy of a run and a card that describes it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from math import isnan, nan
from pathlib import Path
from typing import Any

from rkhs_ros.app.inline import load_acting
from rkhs_ros.app.robots import robot_of
from rkhs_ros.app.trust import add_trust_argument, reads_data
from rkhs_ros.base.endings import RunError, error_message
from rkhs_ros.base.files import read_whole, write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.pictures.film import shoot
from rkhs_ros.pictures.film_files import animate
from rkhs_ros.policies.onnx_check import export_onnx
from rkhs_ros.policies.policy import Policy, load
from rkhs_ros.rollouts.evaluation import Evaluation
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.runs.report import CONFIGURATION, last_policy, new_folder, old_folder
from rkhs_ros.studies.aggregates import Estimate

FILM = "film.gif"
PICTURES = {FILM: "An episode of the policy", "policy.png": "The mean action", "curve.png": "The learning curve"}
FILES = {"policy.npz": "rkhs_ros or numpy", "policy.onnx": "ONNX Runtime", CONFIGURATION: "`rkhs train`"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("run_folder", type=Path, metavar="DIR", help="a finished run's folder")
    parser.add_argument("folder", type=Path, metavar="FOLDER", nargs="?", help="new folder (default: DIR/published)")
    parser.add_argument("--env", metavar="ID", help="the environment, if its module is not installed")
    add_trust_argument(parser)


@reads_data
def run(options: argparse.Namespace) -> int:
    """Write the policy, its pictures and the card, and print their paths."""
    source = old_folder(options.run_folder)
    policy, config = load(last_policy(source)), load_config(source / CONFIGURATION)
    table = _table(source, policy, config)  # before the folder is created, since a file may be missing
    folder = new_folder(options.folder or source / "published", "")
    for name in ("policy.npz", CONFIGURATION, *PICTURES):
        if (source / name).is_file():
            write_whole(folder / name, read_whole(source / name))
    for name, write in {"policy.onnx": _write_onnx, FILM: _write_film}.items():
        try:
            write(options, policy, folder / name)
        except (ValueError, RunError) as error:  # the file is optional
            print(f"note: {name} is missing. {error_message(error)}", file=sys.stderr)
    write_whole(folder / "README.md", _card(source, folder, config, table).encode())
    print(*sorted(folder.iterdir()), sep="\n")
    return 0


def _write_onnx(options: argparse.Namespace, policy: Policy, file: Path) -> None:
    """Export the policy."""
    export_onnx(policy, file)


def _write_film(options: argparse.Namespace, policy: Policy, file: Path) -> None:
    """Render an episode, unless the run has a film or belongs to a robot."""
    if file.is_file() or robot_of(options.run_folder) is not None:
        return
    with load_acting(options.run_folder, options.env) as acting:
        animate(file, shoot(*acting))


def _table(source: Path, policy: Policy, config: Config) -> dict[str, str]:
    """Return the names and values of the table in README.md."""
    algorithm, spaces, mean = config.settings["algorithm.name"], policy.spaces, policy.gaussian.mean
    curve = Curve(source / "curve.csv")
    rows = curve.rows()
    require(len(rows) > 0, f"{curve.path}", "at least one iteration", "none")
    last = rows[-1]
    return {
        **_returns(source, config, "exploration" if isnan(last.evaluation_return) else "evaluation"),
        "Training": f"{algorithm}, {last.episodes} episodes, {last.steps} steps, seed {config.training.seed}",
        "Observation": f"shape {spaces.observation_shape}; {', '.join(spaces.observation_names) or 'no names'}",
        "Action": f"shape {spaces.action_low.shape}; {', '.join(spaces.action_names) or 'no names'}",
        "Bounds": f"{spaces.action_low.tolist()} to {spaces.action_high.tolist()}",
        "Mean": f"{len(mean.centres)} kernel functions of {mean.input_dim} inputs",
    }


def _card(source: Path, folder: Path, config: Config, table: Mapping[str, str]) -> str:
    """Return the text of README.md."""
    settings = read_whole(source / CONFIGURATION).decode()
    table = {**table, "Versions": settings.partition("\n")[0].removeprefix("# ")}
    pictures = [f"![{about}]({name})" for name, about in PICTURES.items() if (folder / name).is_file()]
    files = [f"| [{name}]({name}) | {use} |" for name, use in FILES.items() if (folder / name).is_file()]
    return "\n".join(
        [
            f"# A policy for {config.environment.id}\n",
            *pictures,
            "\n| | |\n|---|---|",
            *(f"| {name} | {value} |" for name, value in table.items()),
            "\n## Load it\n\n```python\nimport rkhs_ros",
            'policy = rkhs_ros.load("policy.npz")  # policy.reset() starts an episode',
            "action = policy(observation)\n```\n\n| File | For |\n|---|---|",
            *files,
            f"\n## Settings\n\n```yaml\n{settings.rstrip()}\n```\n",
        ]
    )


def _returns(source: Path, config: Config, kind: str) -> dict[str, str]:
    """Return the mean returns of the last episodes with their 95 % intervals, as names and values for the table."""
    episodes = load_episodes(source / "episodes.npz").episodes
    training = config.training
    measured: dict[str, Any] = Evaluation.of(
        episodes, config.environment.id, training.seed, training.discount
    ).statistics()
    returns = {f"discounted by {training.discount:g}": measured, "undiscounted": measured["undiscounted"]}
    of = f"of the last {kind} episodes ({len(episodes)})"
    return {
        f"Return, {name}": f"{Estimate(each['mean'], *(each['interval_95'] or (nan, nan)))}, mean {of}"
        for name, each in returns.items()
    }
