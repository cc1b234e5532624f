"""Measure the cost of recording: its share of the time of simulated runs, and the size of the file."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

from command import parser
from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.threads import one_thread
from rkhs_ros.recordings.definitions import Types, encoded
from rkhs_ros.recordings.recorder import Recorder
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.run import run_training

ROOT = Path(__file__).parents[1]
RUNS = ("pendulum_nac", "pendulum_pomdp_power", "toy_nac", "pendulum_model_nac")
ITERATIONS, REPEATS = 10, 3
QUICK = ("toy_nac",), 2, 1
KINDS = ("Task", "Policy", "RecordedEpisodes", "Update")
WRITING = ("begin", "serve", "ended", "updated", "close")  # methods of a recorder


class Stopwatch:
    """Adds up the time of calls."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, call: Callable[..., None]) -> Callable[..., None]:
        """Return a wrapper of a function that measures its time."""

        def counted(*arguments: object) -> None:
            begin = time.process_time()
            call(*arguments)
            self.seconds += time.process_time() - begin

        return counted


@one_thread()
def main(runs: Sequence[str], iterations: int, repeats: int) -> None:
    """Print the share of the time spent on recording."""
    watch = Stopwatch()
    begin = time.process_time()
    for kind in KINDS:
        encoded(getattr(Types(), kind)())
    print(f"once in a process: {1e3 * (time.process_time() - begin):.0f} ms, for the definitions of the messages")
    for name in WRITING:
        setattr(Recorder, name, watch.timed(getattr(Recorder, name)))
    for name in runs:
        config = load_config(ROOT / "config" / f"{name}.yaml", [f"iterations={iterations}"])
        whole, writing, size, episodes = [], [], 0, 0
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                watch.seconds, begin = 0.0, time.process_time()
                run_training(config, runner_of(config.environment), Path(folder), quiet=True)
                whole.append(time.process_time() - begin)
                writing.append(watch.seconds)
                size = (Path(folder) / "recording.mcap").stat().st_size
                episodes = sum(each.batch.num_envs for each in read_recording(Path(folder)).batches)
        part = median(100 * one / other for one, other in zip(writing, whole, strict=True))
        print(
            f"{name}: {median(whole):.2f} s, of which recording {1e3 * median(writing):.1f} ms ({part:.2f} %); "
            f"{size / 1e6:.2f} MB for {episodes} episodes"
        )


if __name__ == "__main__":
    main(*(QUICK if parser(__doc__).parse_args().quick else (RUNS, ITERATIONS, REPEATS)))
