"""What the learner knows of one simulator."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from rkhs_interfaces.msg import Episodes as EpisodesMessage
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, episodes_of, spaces_of, start_request
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch


class SimulatorLink:
    """One simulator as the learner sees it.

    Owns the task it simulates, the batch that it was asked for and how, and the episodes that it sent.

    Args:
        node: the learner node.
        namespace: the simulator's.
        refuse: is told why episodes are refused.
    """

    def __init__(self, node: Node, namespace: str, refuse: Callable[[str], None]) -> None:
        self.name = f"{namespace}simulator"
        self.task: DescribeTask.Response = DescribeTask.Response()
        self.spaces = Spaces.unbounded(1, 1)
        self.batch: Batch | None = None
        self.heard: Episodes | None = None
        self.request = StartEpisodes.Request()
        self.step = 0
        self._refuse = refuse
        self.start = node.create_client(StartEpisodes, f"{namespace}start_episodes")
        self.describe = node.create_client(DescribeTask, f"{namespace}describe_task")
        node.create_subscription(EpisodesMessage, f"{namespace}episodes", self._hear, LOCKSTEP_QOS)

    def know(self, task: DescribeTask.Response) -> None:
        """File what the simulator simulates.

        Raises:
            ValueError: it is no task.
        """
        self.task, self.spaces = task, spaces_of(task)

    def rest(self) -> None:
        """Have nothing to do."""
        self.batch, self.heard = None, None

    def begin(self, batch: Batch, identity: int, version: int, clock: int) -> None:
        """Wait for the episodes of a batch of this number, in which the policy of that version acts."""
        self.batch, self.heard, self.step = batch, None, 0
        self.request = start_request(identity, version, batch, self.task, clock)

    @property
    def busy(self) -> bool:
        """Whether episodes are still to come."""
        return self.batch is not None and self.heard is None

    def lost(self, task: DescribeTask.Response) -> bool:
        """Return whether the batch is lost: the simulator died since, or somebody else had it begin another."""
        return bool(task.batch != self.request.batch)

    def moved(self, task: DescribeTask.Response) -> bool:
        """Return whether the simulator came to another step since this was asked before."""
        before, self.step = self.step, int(task.step)
        return self.step != before

    def _hear(self, message: EpisodesMessage) -> None:
        expected = (self.request.batch, self.request.policy_version)
        if self.batch is None or (message.batch, message.policy_version) != expected:
            return  # late, or of another learner
        try:
            self.heard = episodes_of(message, self.batch, self.spaces)
        except ValueError as error:
            self._refuse(f"episodes: {error}")
