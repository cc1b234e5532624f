"""``rkhs tune-node``: tune the parameters of a ROS 2 node in a few dozen trials."""

import argparse
import csv
import signal
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import require, require_ros
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.robot.tuning import Trials, Tuning, best_places, next_places, noise_of, tuning_from

if TYPE_CHECKING:
    from rkhs_ros.nodes.robot.tuned_node import TunedNode

CONFIRMED = 3  # best trials that are repeated at the end
RECORD, BEST = "trials.csv", "parameters.yaml"


def add_tune_node(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("file", type=Path, metavar="FILE", help="YAML file of the tuning; see docs/tune_node.md")
    add("--trials", type=int, metavar="N", help="maximum number of trials instead of that of the file")
    add("--seed", type=int, default=0, metavar="N", help="seed of all randomness (default: %(default)s)")
    add("--out", type=Path, metavar="DIR", help="folder of the run (default: results/FILE); an unfinished run resumes")
    add("--apply", action="store_true", help="leave the best parameters set at the end")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the trials; print the best parameters, and write them to a file for ``ros2 param load``.

    Raises:
        ValueError: ROS is missing, or the file does not describe a tuning of the node.
        RunError: a node is silent, or the reward fails.
    """
    require_ros("rkhs tune-node")
    tree = loaded(options.file.read_text())
    tuning = tuning_from(tree | ({"trials": options.trials} if options.trials else {}))
    folder = options.out or Path("results", options.file.stem)
    from rkhs_ros.nodes.robot.tuned_node import TunedNode, write_parameters  # here, since the import needs ROS

    for number in (signal.SIGHUP, signal.SIGQUIT):  # like Ctrl-C: the parameters are set again
        signal.signal(number, lambda number, frame: signal.raise_signal(signal.SIGINT))
    record = Record(folder / RECORD, tuning)
    with one_thread(), closing(TunedNode(tuning, folder)) as node:
        values = _best(node, tuning, record, options.seed)
        write_parameters(folder / BEST, node.name, values)
        for name, value in values.items():
            print(f"{name}: {value:.6g} (before: {node.before[name]:.6g})")
        print(f"ros2 param load {node.name} {folder / BEST}")
        if options.apply:
            node.keep(values)
            print("The node keeps these parameters.", file=sys.stderr)
    return 0


class Record:
    """The finished trials of a run, in a file with one line for each.

    Raises:
        ValueError: the file belongs to another tuning, or is damaged.
    """

    def __init__(self, path: Path, tuning: Tuning) -> None:
        self._path, self._tuning = path, tuning
        self._columns = [*tuning.context, *tuning.parameters, "reward", "rejected"]
        self.rows: list[list[Any]] = []
        if path.is_file():
            header, *rows = list(csv.reader(path.read_text().splitlines())) or [[]]
            require(header == self._columns, f"{path}", f"the columns {', '.join(self._columns)}", ", ".join(header))
            self.rows = [[*map(float, row[:-1]), row[-1]] for row in rows if len(row) == len(header)]  # not a torn one

    @property
    def trials(self) -> Trials:
        """The trials as arrays."""
        tuning = self._tuning
        numbers = np.array([row[:-1] for row in self.rows], dtype=float).reshape(len(self.rows), len(self._columns) - 1)
        contexts, values = numbers[:, : len(tuning.context)], numbers[:, len(tuning.context) : -1]
        places = [tuning.places(dict(zip(tuning.parameters, row, strict=True))) for row in values]
        return Trials(contexts, np.reshape(places, values.shape), numbers[:, -1])

    def run(self, node: "TunedNode", context: np.ndarray, values: dict[str, Any]) -> float:
        """Run a trial, add it to the file, say how it went, and return its reward."""
        reward, reason = node.trial(values)
        self.rows.append([*context, *values.values(), reward, reason])
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", newline="") as file:
            csv.writer(file).writerows([self._columns, self.rows[-1]] if len(self.rows) == 1 else [self.rows[-1]])
        told = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        end = f"rejected: {reason}" if reason else f"reward {reward:.4g}"
        print(f"trial {len(self.rows)} of {self._tuning.trials}: {told}: {end}", file=sys.stderr, flush=True)
        return reward


def _best(node: "TunedNode", tuning: Tuning, record: Record, seed: int) -> dict[str, Any]:
    """Run the trials, repeat the best ones, and return the best parameters, for the current context if there is one."""
    confirmed = 0 if tuning.context else CONFIRMED
    while len(record.rows) < tuning.trials - confirmed:
        context, trials = node.context(), record.trials
        places, gain = next_places(trials, context, seed)
        if gain < noise_of(trials):
            print(f"the expected gain is below the noise after {len(record.rows)} trials", file=sys.stderr)
            break
        record.run(node, context, node.values(places))
    trials = record.trials
    if tuning.context:
        return node.values(best_places(trials, node.context(), seed))
    scores = {}
    for row in np.argsort(-trials.rewards, kind="stable")[:confirmed]:
        scores[row] = trials.rewards[row] + record.run(node, node.context(), node.values(trials.places[row]))
    return node.values(trials.places[max(scores, key=lambda row: float(scores[row]))])
