"""Measure the control loop of a robot at 50 Hz: jitter of the period, late actions, and latency.

Simulated robot, gate, robot node, policy node and learner run in separate processes, as in `rkhs train`. A busy machine
is not suitable for a robot: check the load that is printed first.
"""

import os
import tempfile
from itertools import count
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import rclpy

from command import parser
from rkhs_interfaces.msg import Command, GateReport
from rkhs_ros.app.launcher import started, write_parameters
from rkhs_ros.app.robots import check_robot
from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.learning.state import first_policy
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS
from rkhs_ros.nodes.core.transport import by_udp, node_names
from rkhs_ros.nodes.lockstep.learner_node import LearnerNode
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.robot.episode import LATE, MISSED
from rkhs_ros.runs.config import Config, load_config

CONFIG = Path(__file__).parents[1] / "config" / "robot_pendulum.yaml"
PERIOD, CENTRES = 0.02, 80
HORIZON, EPISODES = 1000, 3
QUICK = 10, 1
WARM_UP = 10  # steps of an episode
AT_50_HZ = (f"robot.period={PERIOD}", "robot.misses_allowed=1000", "gate.command_timeout=25.0")


class Loop:
    """The messages of the loop: stamps in nanoseconds, by the numbers of the commands."""

    def __init__(self, learner: LearnerNode) -> None:
        self.observed: dict[int, int] = {}
        self.sent: dict[int, int] = {}
        self.executions: list[Execution] = []
        self._learner = learner
        learner.create_subscription(Command, "command", self._hear_command, LOCKSTEP_QOS)
        learner.create_subscription(GateReport, "gate/report", self._hear_report, LOCKSTEP_QOS)
        learner.runner.record = self._record

    def wait_until_heard(self, policy: GaussianPolicy) -> None:
        """Run short episodes until messages of both topics arrive, then discard the messages."""
        numbers = count()
        while not len(self.latencies):
            self._learner.runner.collect(policy, Batch(0, next(numbers), 1, WARM_UP, explore=True))
        for heard in (self.observed, self.sent, self.executions):
            heard.clear()

    def _record(self, batch: Batch, episodes: Episodes, executions: list[Execution]) -> None:
        self.executions += executions

    def _hear_command(self, message: Command) -> None:
        self.observed[message.number] = nanoseconds(message)

    def _hear_report(self, message: GateReport) -> None:
        self.sent[message.number] = nanoseconds(message)

    @property
    def periods(self) -> np.ndarray:
        """Milliseconds of all steps except the first of each episode, which waits for the policy."""
        return 1e-6 * np.concatenate([np.diff(execution.stamps)[1:] for execution in self.executions])

    @property
    def latencies(self) -> np.ndarray:
        """Milliseconds from each observation until the gate received its command."""
        return 1e-6 * np.array(
            [self.sent[number] - stamp for number, stamp in self.observed.items() if number in self.sent]
        )

    def count(self, flag: int) -> int:
        """Return how many steps have a flag."""
        return sum(int((execution.flags & flag > 0).sum()) for execution in self.executions)


def nanoseconds(message: Command | GateReport) -> int:
    """Return the stamp of a message."""
    return int(10**9 * message.stamp.sec + message.stamp.nanosec)


def policy_of(config: Config) -> GaussianPolicy:
    """Return a policy of typical size that hardly moves the robot."""
    first = first_policy(config.training, check_robot(config))
    centres = np.linspace([-3.0, -3.0], [3.0, 3.0], CENTRES)
    return first.with_mean(Function(RBF((1.0, 1.0)), centres, np.full((CENTRES, 1), 1e-3)))


def row(name: str, values: np.ndarray) -> str:
    """Return a line of the table."""
    return f"{name:<28}{values.mean():9.2f}{np.median(values):9.2f}{np.quantile(values, 0.999):9.2f}{values.max():9.2f}"


def main(horizon: int, episodes: int) -> None:
    """Print the table."""
    os.environ.update(by_udp(os.environ))
    config = load_config(CONFIG, [*AT_50_HZ, f"horizon={horizon}"])
    with tempfile.TemporaryDirectory() as folder:
        parameters = write_parameters(config, Path(folder) / "parameters.yaml")
        rclpy.init(args=["--ros-args", "--params-file", str(parameters)])
        with started(node_names(config.environment.nodes)[:-1], parameters):
            learner = LearnerNode("learner")
            learner.open()
            loop, policy = Loop(learner), policy_of(config)
            learner.runner.connect()
            loop.wait_until_heard(policy)
            learner.runner.collect(policy, Batch(1, 0, episodes, horizon, explore=True))
        rclpy.shutdown()
    steps, load = len(loop.periods), os.getloadavg()[0]
    print(f"{steps} steps of {1e3 * PERIOD:g} ms; load {load:.1f} on {os.cpu_count()} cores")
    print(f"{'ms':<28}{'mean':>9}{'median':>9}{'99.9 %':>9}{'worst':>9}")
    print(row("period", loop.periods))
    print(row("observation to gate", loop.latencies))
    print(f"late ticks {loop.count(LATE)}, actions that missed the deadline {loop.count(MISSED)}")


if __name__ == "__main__":
    main(*(QUICK if parser(__doc__).parse_args().quick else (HORIZON, EPISODES)))
