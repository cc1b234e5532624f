"""Measure the speedup of a study with two processes, and on a Dask cluster of two workers.

Each variant runs the same sweep in a separate folder. The time includes the imports of the processes.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

from command import parsed, parser
from rkhs_ros.app.cli import main

CONFIG = Path(__file__).parents[1] / "config" / "pendulum_nac.yaml"
SWEEP = ("sweep", str(CONFIG), "--vary", "algorithm.ridge=1e-3,1e-2", "--quiet")
QUICK = ("--set", "iterations=1", "horizon=5")


def seconds_of(runs: int, folder: Path, *how: str) -> float:
    """Return the seconds of a sweep with a number of runs."""
    begin = time.perf_counter()
    try:
        main([*SWEEP, "--seeds", f"0-{runs // 2 - 1}", "--out", str(folder), *how])
    except SystemExit as end:
        if end.code:
            raise
    return time.perf_counter() - begin


if __name__ == "__main__":
    command = parser(__doc__)
    command.add_argument("--runs", type=int, default=20, help="an even number; default: 20")
    command.add_argument("--scheduler", help="address of a Dask cluster to measure as well")
    options = parsed(command, runs=2)
    changes = QUICK if options.quick else ()
    places = [("--jobs", "1"), ("--jobs", "2"), *([("--scheduler", options.scheduler)] if options.scheduler else [])]
    with tempfile.TemporaryDirectory() as parent:
        seconds = [seconds_of(options.runs, Path(parent) / str(n), *place, *changes) for n, place in enumerate(places)]
    for place, taken in zip(places, seconds, strict=True):
        print(f"{' '.join(place):<36} {taken:7.1f} s   {seconds[0] / taken:.2f} times as fast as one process")
