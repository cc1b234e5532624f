"""Measure the PR2 episodes per second in process and over topics."""

from __future__ import annotations

import os
import tempfile
from itertools import count
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import rclpy

from command import needing, parser
from rkhs_ros.app.inline import runner_of
from rkhs_ros.app.launcher import for_all, started
from rkhs_ros.learning.state import first_policy
from rkhs_ros.nodes.core.names import node_names
from rkhs_ros.nodes.core.transport import by_udp
from rkhs_ros.nodes.lockstep.learner_node import LearnerNode
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import resolved
from timing import seconds_of

with needing("pybullet", "pip install pybullet"):
    import sim_nodes.pr2.world  # noqa: F401

CONFIG = Path(__file__).parents[1] / "config" / "pr2_door_power.yaml"
EPISODES, ROUNDS = 20, 5
QUICK = 2, 1


def episodes_per_second(episodes: int, rounds: int) -> float:
    """Return the median over rounds of the episodes per second."""
    config = load_config(CONFIG)
    with tempfile.TemporaryDirectory() as folder:
        parameters = Path(folder) / "parameters.yaml"
        parameters.write_text(for_all(resolved(config)))
        rclpy.init(args=["--ros-args", "--params-file", str(parameters)])
        with started(node_names()[:-1], parameters):
            learner = LearnerNode()
            learner.open()
            learner.runner.connect()
            policy = first_policy(config.training, learner.runner.spaces)
            seconds = seconds_per_batch(learner.runner, policy, episodes, rounds)
        rclpy.shutdown()
    return episodes / seconds


def seconds_per_batch(runner, policy, episodes: int, rounds: int) -> float:
    """Return the median time of a batch over rounds, after a warm-up round."""
    numbers = count()
    return seconds_of(
        lambda: runner.collect(policy, Batch(0, next(numbers) * episodes, episodes, 1, explore=True)), rounds
    )


def main(episodes: int, rounds: int) -> None:
    """Print the table."""
    os.environ.update(by_udp(os.environ))  # this process is the learner, and uses the transport of the other nodes
    config = load_config(CONFIG)
    inline = runner_of(config.environment)
    policy = first_policy(config.training, inline.spaces)
    single = seconds_per_batch(inline, policy, episodes, rounds) / episodes
    print(f"an episode in process           {1e3 * single:6.1f} ms   (at most 150 ms)")
    print(f"episodes/s over topics          {episodes_per_second(episodes, rounds):6.2f}")


if __name__ == "__main__":
    main(*(QUICK if parser(__doc__).parse_args().quick else (EPISODES, ROUNDS)))
