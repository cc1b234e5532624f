"""Compare the lockstep over topics with a raw round trip of the same message, and a run with one in process.

Compare the ratios, since machines are noisy.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor

import sim_nodes.envs  # noqa: F401  # registers the tasks
from command import parser, seconds_of
from rkhs_interfaces.msg import Observation
from rkhs_ros.app.launcher import started, write_parameters
from rkhs_ros.learning.training import train
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, observation_message
from rkhs_ros.nodes.core.transport import by_udp
from rkhs_ros.nodes.lockstep.learner_node import LearnerNode
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, load_config

CONFIG = Path(__file__).parents[1] / "config" / "pendulum_nac.yaml"
ROUNDS, TRIPS, QUICK_TRIPS = 5, 1000, 10
QUICK = ("iterations=2", "horizon=5")


def echo() -> None:
    """Send every message back, in a separate process."""
    rclpy.init()
    node = rclpy.create_node("echo")
    back = node.create_publisher(Observation, "pong", LOCKSTEP_QOS)
    node.create_subscription(Observation, "ping", back.publish, LOCKSTEP_QOS)
    executor = EventsExecutor()
    executor.add_node(node)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        while rclpy.ok():
            executor.spin_once(timeout_sec=3600.0)


def ping_pong(message: Observation, trips: int) -> float:
    """Return the seconds of a round trip of the message between two processes."""
    process = subprocess.Popen([sys.executable, __file__, "--echo"])
    node = rclpy.create_node("ping")
    forth = node.create_publisher(Observation, "ping", LOCKSTEP_QOS)
    heard: list[Observation] = []
    back = node.create_subscription(Observation, "pong", heard.append, LOCKSTEP_QOS)
    executor = EventsExecutor()
    executor.add_node(node)
    while not (back.get_publisher_count() and forth.get_subscription_count()):
        executor.spin_once(timeout_sec=0.01)

    def trip() -> None:
        heard.clear()
        forth.publish(message)
        while not heard:
            executor.spin_once(timeout_sec=1.0)

    seconds = seconds_of(trip, ROUNDS, trips)
    process.terminate()
    process.wait()
    executor.shutdown()
    node.destroy_node()
    return seconds


def over_topics(config: Config, policy: GaussianPolicy) -> tuple[float, float]:
    """Return the seconds of a step and of a run, with this process as the learner; call it once per process."""
    batch = batch_of(config)
    with tempfile.TemporaryDirectory() as folder:
        parameters = write_parameters(config, Path(folder) / "parameters.yaml")
        rclpy.init(args=["--ros-args", "--params-file", str(parameters)])
        with started(("simulator", "policy"), parameters):
            learner = LearnerNode("learner")
            learner.open()
            runner = learner.runner
            runner.connect()
            runner.collect(policy, batch)
            step = seconds_of(lambda: runner.collect(policy, batch), ROUNDS, 5) / batch.horizon
            begin = time.perf_counter()
            for _ in train(config.training, runner):
                pass
            run = time.perf_counter() - begin
            learner.destroy_node()
        rclpy.shutdown()
    return step, run


def batch_of(config: Config) -> Batch:
    """Return the episodes of an iteration."""
    return Batch(0, 0, config.training.episodes_per_iteration, config.training.horizon, explore=True)


def main(trips: int, changes: Sequence[str]) -> None:
    """Print the table."""
    os.environ.update(by_udp(os.environ))  # the learners use the transport of the other nodes
    config = load_config(CONFIG, changes)
    simulation = Simulation(config.environment.id, config.environment.options)
    batch = batch_of(config)
    inline = InlineRunner(simulation)

    begin = time.perf_counter()
    *_, last = train(config.training, inline)
    inline_run = time.perf_counter() - begin
    inline_step = seconds_of(lambda: inline.collect(last.policy, batch), ROUNDS, 5) / batch.horizon
    rclpy.init()
    raw = ping_pong(observation_message(1, 1, batch, 1, simulation.step(np.zeros((batch.num_envs, 1)))), trips)
    rclpy.shutdown()
    print(f"raw ping-pong of the same message, two processes  {1e6 * raw:8.0f} us")
    print(f"in process: a step of {batch.num_envs} environments            {1e6 * inline_step:8.0f} us")
    print(f"            a pendulum run                        {inline_run:8.2f} s")
    step, run = over_topics(config, last.policy)
    print(f"over topics: a step {1e6 * step:30.0f} us   {step / raw:.2f} times the ping-pong (aim 1.5)")
    print(f"            environment steps per second {batch.num_envs / step:9.0f}")
    print(f"            a pendulum run {run:23.2f} s    {run / inline_run:.2f} times in process (aim 2.5)")


if __name__ == "__main__":
    command = parser(__doc__)
    command.add_argument("--echo", action="store_true", help="send messages back to the measuring process")
    options = command.parse_args()
    if options.echo:
        echo()
    else:
        main(*((QUICK_TRIPS, QUICK) if options.quick else (TRIPS, ())))
