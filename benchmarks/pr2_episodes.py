"""Episodes of the PR2 per second over topics, with one simulator node and with two, side by side in one run."""

from __future__ import annotations

import os
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path
from statistics import median

os.environ["OMP_NUM_THREADS"] = "1"

import rclpy

from rkhs_ros.app.launcher import for_all, started
from rkhs_ros.learning.state import first_policy
from rkhs_ros.nodes.learner_node import LearnerNode
from rkhs_ros.nodes.names import node_names
from rkhs_ros.nodes.transport import by_udp
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import resolved
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.simulation import Simulation

CONFIG = Path(__file__).parents[1] / "config" / "pr2_door_power.yaml"
EPISODES, ROUNDS = 20, 5


def episodes_per_second(simulators: int) -> float:
    """Return the median over rounds of the episodes per second."""
    config = load_config(CONFIG, [f"simulators={simulators}"])
    with tempfile.TemporaryDirectory() as folder:
        parameters = Path(folder) / "parameters.yaml"
        parameters.write_text(for_all(resolved(config), simulators))
        rclpy.init(args=["--ros-args", "--params-file", str(parameters)])
        with started(node_names(simulators)[:-1], parameters):
            learner = LearnerNode()
            learner.open()
            learner.connect()
            policy = first_policy(config.training, learner.spaces)
            rounds = [seconds_of(learner, policy, k) for k in range(ROUNDS + 1)]
        rclpy.shutdown()
    return EPISODES / median(rounds[1:])


def seconds_of(runner, policy, number: int) -> float:
    """Return how long a batch takes."""
    begin = time.perf_counter()
    runner.collect(policy, Batch(0, number * EPISODES, EPISODES, 1, explore=True))
    return time.perf_counter() - begin


def main() -> None:
    """Print the table."""
    os.environ.update(by_udp(os.environ))  # this process is the learner, and talks as the other nodes do
    config = load_config(CONFIG)
    inline = InlineRunner(Simulation(config.environment.id, config.environment.options))
    policy = first_policy(config.training, inline.spaces)
    single = [seconds_of(inline, policy, k) / EPISODES for k in range(ROUNDS + 1)][1:]
    print(f"an episode in process           {1e3 * median(single):6.1f} ms   (at most 150 ms)")
    with get_context("spawn").Pool(1, maxtasksperchild=1) as pool:  # a learner that finds another one there ends
        one, two = pool.map(episodes_per_second, (1, 2), chunksize=1)
    print(f"episodes/s, one simulator node  {one:6.2f}")
    print(f"episodes/s, two simulator nodes {two:6.2f}      {two / one:.2f} times (aim 1.6)")


if __name__ == "__main__":
    main()
