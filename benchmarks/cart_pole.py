"""Measure after how many episodes the cart-pole stays upright, and whether it still does in later iterations.

The defaults of ``rkhs train --env`` learn `rkhs/CartPoleSwingUp-v0`. An evaluation succeeds if the cart stays within
0.1 m and the pole within 0.25 rad of upright in the last second of at least 9 of its 10 episodes. A line per iteration
is appended to a CSV file; seeds that are already in the file are not repeated.
"""

from __future__ import annotations

import csv
import os
import sys
import time
from argparse import Namespace
from pathlib import Path
from typing import NamedTuple

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

from command import parsed, parser
from rkhs_ros.app.inline import runner_of
from rkhs_ros.app.seeds import parse_seeds
from rkhs_ros.base.endings import print_error
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training import train
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from sim_nodes.envs.cart_pole import CartPole

ENVIRONMENT = "rkhs/CartPoleSwingUp-v0"
SUCCESS = 0.9  # share of balanced evaluation episodes


class Row(NamedTuple):
    """One iteration.

    Attributes:
        seed: seed of the run.
        episodes: real episodes so far.
        undiscounted_return: mean over the evaluation episodes.
        balanced: share of the evaluation episodes that stay upright.
        cpu_seconds: CPU time so far, including evaluations.
    """

    seed: int
    episodes: int
    undiscounted_return: float
    balanced: float
    cpu_seconds: float

    @property
    def succeeds(self) -> bool:
        """Whether enough evaluation episodes stay upright."""
        return self.balanced >= SUCCESS


def balanced_share(task: CartPole, episodes: Episodes) -> float:
    """Return the share of episodes whose pole stays upright."""
    return float(np.mean([task.balanced(observations) for observations in episodes.next_observations]))


def measure(path: Path, seed: int, episodes: int) -> None:
    """Train with a seed, and append a line per iteration to the file."""
    config = config_for(ENVIRONMENT, time_limit(ENVIRONMENT), (f"seed={seed}", f"iterations={episodes}"))
    task, begin = CartPole(), time.process_time()
    for iteration in train(config.training, runner_of(config.environment)):
        evaluation = iteration.evaluation
        mean, balanced = float(evaluation.returns(1.0).mean()), balanced_share(task, evaluation)
        row = Row(seed, iteration.episodes_used, round(mean, 2), balanced, round(time.process_time() - begin, 1))
        with path.open("a", newline="") as file:
            csv.writer(file).writerow(row)


def read(path: Path) -> dict[int, list[Row]]:
    """Return the iterations of each seed in the file, whose first line is a header."""
    found: dict[int, list[Row]] = {}
    with path.open(newline="") as file:
        for line in list(csv.reader(file))[1:]:
            row = Row(int(line[0]), int(line[1]), *map(float, line[2:]))
            found.setdefault(row.seed, []).append(row)
    return found


def summary(runs: dict[int, list[Row]]) -> str:
    """Return a table with a line per seed, and the median."""
    lines, firsts = ["seed  first success  CPU s until then  later successes  last return"], []
    for seed, rows in runs.items():
        first = next((i for i, row in enumerate(rows) if row.succeeds), None)
        firsts.append(np.inf if first is None else rows[first].episodes)
        later = [] if first is None else rows[first + 1 :]
        kept = f"{sum(row.succeeds for row in later)} of {len(later)}"
        number, seconds = ("-", "-") if first is None else (rows[first].episodes, rows[first].cpu_seconds)
        lines.append(f"{seed:4d}  {number:>13}  {seconds:>16}  {kept:>15}  {rows[-1].undiscounted_return:>11}")
    return "\n".join([*lines, f"median of the first success: {np.median(firsts):g} episodes"])


def run(options: Namespace) -> None:
    """Train with the missing seeds and print the table."""
    options.out.parent.mkdir(parents=True, exist_ok=True)
    if not options.out.exists():
        options.out.write_text(",".join(Row._fields) + "\n")
    for seed in parse_seeds(options.seeds):
        if seed not in read(options.out):
            measure(options.out, seed, options.episodes)
    print(summary(read(options.out)))


def main() -> int:
    """Run the command; return its exit code."""
    command = parser(__doc__)
    command.add_argument("--seeds", default="200-204", help="such as 0-9 or 0,2,5; default: 200-204")
    command.add_argument("--episodes", type=int, default=15, help="real episodes of a run; default: 15")
    out = Path("results") / "cart_pole.csv"
    command.add_argument("--out", type=Path, default=out, help=f"default: {out}")
    options = parsed(command, None, seeds="200", episodes=1)
    try:
        run(options)
    except (ValueError, OSError) as error:
        return print_error(error)
    return 0


if __name__ == "__main__":
    sys.exit(main())
