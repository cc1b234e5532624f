"""``rkhs tune-node``: tune the parameters of a ROS 2 node in a few dozen trials."""

import argparse
import csv
import signal
import sys
from contextlib import closing
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import locked, write_whole
from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import prefixed, require, require_ros, truncated
from rkhs_ros.base.yaml_text import dumped, loaded
from rkhs_ros.robot.tuning import Trials, Tuning, best_places, next_places, noise_of, tuning_from
from rkhs_ros.runs.report import new_folder

if TYPE_CHECKING:
    from rkhs_ros.nodes.robot.tuned_node import TunedNode

CONFIRMED = 3  # best trials that are repeated at the end
TUNING, RECORD, BEST = "tuning.yaml", "trials.csv", "parameters.yaml"  # in the folder of a run


def add_tune_node(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("file", type=Path, metavar="FILE", help="YAML file of the tuning; see docs/tune_node.md")
    add("--trials", type=int, metavar="N", help="maximum number of trials instead of that of the file")
    add("--seed", type=int, default=0, metavar="N", help="seed of all randomness (default: %(default)s)")
    add("--out", type=Path, metavar="DIR", help="folder of the run (default: results/FILE); an unfinished run resumes")
    add("--apply", action="store_true", help="leave the best parameters set at the end")


def run_tune_node(options: argparse.Namespace) -> int:
    """Run the trials; print the best parameters, and write them to a file for ``ros2 param load``."""
    require_ros("rkhs tune-node")
    with prefixed(options.file):
        tree = loaded(options.file.read_text())
        tuning = tuning_from(tree)
    tuning = replace(tuning, trials=tuning.trials if options.trials is None else options.trials)
    require(0 <= options.seed < 2**63, "--seed", "a whole number in [0, 2^63)", options.seed)
    folder = options.out or Path("results", options.file.stem)
    from rkhs_ros.nodes.robot.tuned_node import TunedNode, write_parameters  # here, since the import needs ROS

    for number in (signal.SIGHUP, signal.SIGQUIT):  # like Ctrl-C: the parameters are set again
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, lambda number, frame: signal.raise_signal(signal.SIGINT))
    _begin(folder, dumped({"seed": options.seed} | {key: each for key, each in tree.items() if key != "trials"}))
    with locked(folder), one_thread(), closing(TunedNode(tuning, folder)) as node:
        record = Record(folder / RECORD, tuning)
        values = _best(node, tuning, record, options.seed)
        write_parameters(folder / BEST, node.tuned, values)
        for name, value in values.items():
            print(f"{name}: {value:.6g} (before: {node.before[name]:.6g})")
        print(f"ros2 param load {node.tuned} {folder / BEST}")
        if options.apply:
            node.keep(values)
            print("The node keeps these parameters.", file=sys.stderr)
    return 0


def _begin(folder: Path, described: str) -> None:
    """Create the folder of a run, or raise ValueError unless it contains a run of the same tuning, which goes on."""
    file = folder / TUNING
    if file.is_file():
        same = file.read_text() == described
        require(same, f"{folder}", "a new folder, or the run of the same tuning and seed", "the run of another one")
    else:
        new_folder(folder, "")
        write_whole(file, described.encode())


class Record:
    """The finished trials of a run, in a file with one line for each; a repetition names the trial that it repeats."""

    def __init__(self, path: Path, tuning: Tuning) -> None:
        self._path, self._tuning = path, tuning
        self._columns = [*tuning.context, *tuning.parameters, "reward", "rejected", "repeats"]
        self.rows: list[list[Any]] = []
        if path.is_file():
            head, *rows = list(csv.reader(path.read_text().splitlines())) or [[]]
            require(head == self._columns, f"{path}", f"the columns {', '.join(self._columns)}", ", ".join(head))
            self.rows = [self._row(number, row) for number, row in enumerate(rows, 2)]

    def _row(self, number: int, row: list[str]) -> list[Any]:
        """Return the values of a line of the file."""
        what, expected = f"{self._path}, line {number}", f"values of {', '.join(self._columns)}"
        try:
            numbers, repeats = [float(each) for each in row[:-2]], int(row[-1] or 0)
        except (ValueError, IndexError) as error:
            raise ValueError(f"{what}: expected {expected}, got {truncated(row)}") from error
        good = len(row) == len(self._columns) and bool(np.isfinite(numbers).all()) and 0 <= repeats < number - 1
        require(good, what, expected, row)
        return [*numbers, *row[-2:]]

    @property
    def trials(self) -> Trials:
        """The trials as arrays, without repetitions."""
        tuning, rows = self._tuning, [row[:-2] for row in self.rows if not row[-1]]
        numbers = np.array(rows, dtype=float).reshape(len(rows), len(self._columns) - 2)
        contexts, values = numbers[:, : len(tuning.context)], numbers[:, len(tuning.context) : -1]
        places = [tuning.places(dict(zip(tuning.parameters, row, strict=True))) for row in values]
        return Trials(contexts, np.reshape(places, values.shape), numbers[:, -1])

    @property
    def repetitions(self) -> dict[int, float]:
        """The rewards of repetitions by the number of the trial, from 1."""
        return {int(row[-1]): float(row[-3]) for row in self.rows if row[-1]}

    def run(self, node: "TunedNode", context: np.ndarray, values: dict[str, Any], repeats: str = "") -> None:
        """Run a trial, or the repetition of one; add it to the file, and say how it went."""
        reward, reason = node.trial(values)
        self.rows.append([*context, *values.values(), reward, reason, repeats])
        text = StringIO(newline="")
        csv.writer(text).writerows([self._columns, *self.rows])
        write_whole(self._path, text.getvalue().encode())
        told = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        end = f"rejected: {reason}" if reason else f"reward {reward:.4g}"
        print(f"trial {len(self.rows)} of {self._tuning.trials}: {told}: {end}", file=sys.stderr, flush=True)


def _best(node: "TunedNode", tuning: Tuning, record: Record, seed: int) -> dict[str, Any]:
    """Run the trials, and repeat the best ones; return the best parameters, with a context those for it now."""
    confirmed = 0 if tuning.context else CONFIRMED
    while len(record.rows) < tuning.trials - confirmed:
        trials = record.trials
        context = node.sense_context()
        places, gain = next_places(trials, context, seed)
        if gain < noise_of(trials):
            print(f"the expected gain is below the noise after {len(record.rows)} trials", file=sys.stderr)
            break
        record.run(node, context, node.values(places))
    trials = record.trials
    accepted = [index for index, row in enumerate(row for row in record.rows if not row[-1]) if not row[-2]]
    if not accepted:
        raise RunError(f"{node.tuned}: expected a trial whose values it accepts, got none of {len(trials.rewards)}")
    if tuning.context:
        return node.values(best_places(trials, node.sense_context(), seed))
    best = sorted(accepted, key=lambda row: -float(trials.rewards[row]))[:confirmed]
    for row in best:
        if row + 1 not in record.repetitions:
            record.run(node, node.sense_context(), node.values(trials.places[row]), repeats=str(row + 1))
    scores = {row: trials.rewards[row] + record.repetitions[row + 1] for row in best}
    row = max(scores, key=lambda row: float(scores[row]))
    print(f"best: trial {row + 1}, mean reward {scores[row] / 2:.4g}", file=sys.stderr)
    return node.values(trials.places[row])
