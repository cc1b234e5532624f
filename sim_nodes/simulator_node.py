"""The simulator node: any Gymnasium environment with continuous actions behind topics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.node import Node

from rkhs_interfaces.msg import Action, Episodes, Observation
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.experiments.config import environment_from
from rkhs_ros.experiments.rollout import EpisodeRecorder
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, batch_of, describe, episodes_message, matrix, observation_message
from rkhs_ros.nodes.parameters import declare, declared, given
from rkhs_ros.nodes.spin import run
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.settings import Entry
from rkhs_ros.rkhs.validation import hint
from sim_nodes.simulation import Frame, Simulation

if TYPE_CHECKING:
    from rkhs_ros.nodes.robot_state import RobotState


class SimulatorNode(Node):
    """Publishes observations, executes actions, and publishes the episodes they make.

    Owns the environment, the step it waits at, and the episodes under way. Does not own the pace: the action is
    the clock. Only the action of the current batch and step is taken, so nothing is stepped twice, and only of
    the policy that acted in the batch's first step.
    """

    def __init__(self) -> None:
        """Make the environment and open topics and services.

        Raises:
            ValueError: an unknown parameter, or an environment that cannot be served.
        """
        super().__init__("simulator", automatically_declare_parameters_from_overrides=True)
        tree = given(self)
        shown = declared(self, tree, "robot_state", False, "publish joint_states and robot_description for viewers")
        self._simulation = self._make_simulation(tree)
        self._robot = self._make_robot_state() if shown else None
        self._batch: Batch | None = None
        self._identity = 0
        self._step = 0
        self._version = 0
        self._observations = self.create_publisher(Observation, "observation", LOCKSTEP_QOS)
        self._episodes = self.create_publisher(Episodes, "episodes", LOCKSTEP_QOS)
        self.create_subscription(Action, "action", self._act, LOCKSTEP_QOS)
        self.create_service(StartEpisodes, "start_episodes", self._start)
        self.create_service(DescribeTask, "describe_task", self._describe)

    def _make_simulation(self, tree: dict[str, dict[str, object]]) -> Simulation:
        for name in tree:
            if name != "environment":
                raise ValueError(f"unknown key '{name}', {hint(name, {'environment.id': None})}")
        environment = environment_from(tree.get("environment", {}))
        declare(self, [Entry("environment.id", environment.id, {"description": "Gymnasium id of the environment"})])
        return Simulation(environment.id, environment.options)

    def _make_robot_state(self) -> RobotState:
        try:
            from rkhs_ros.nodes.robot_state import RobotState
        except ImportError as error:
            raise ValueError(f"robot_state: expected sensor_msgs and std_msgs to be installed, got: {error}") from error
        return RobotState(self, self._simulation)

    def _describe(self, request: DescribeTask.Request, response: DescribeTask.Response) -> DescribeTask.Response:
        heard = self._observations.get_subscription_count() > 0 and self._episodes.get_subscription_count() > 0
        return describe(self._simulation, self._identity, self._step, connected=heard)

    def _start(self, request: StartEpisodes.Request, response: StartEpisodes.Response) -> StartEpisodes.Response:
        try:
            batch = batch_of(request)
            if self._batch is None or (request.batch, batch) != (self._identity, self._batch):
                self._begin(request.batch, batch)  # else it is asked for again, because an answer was lost
        except ValueError as error:
            response.message = str(error)
            return response
        response.accepted = True
        return response

    def _begin(self, identity: int, batch: Batch) -> None:
        frame = self._simulation.start(batch)
        self._batch, self._identity, self._step = batch, identity, 0
        self._recorder = EpisodeRecorder(batch, self._simulation.observation_dim, self._simulation.action_dim)
        self._publish(batch, frame)
        self._record(batch, frame)

    def _act(self, message: Action) -> None:
        batch = self._batch
        if batch is None or not self._awaits(batch, message):
            return  # late, a duplicate, of another batch or of another policy
        try:
            actions = matrix(message.actions, batch.rows, self._simulation.action_dim, "actions")
        except ValueError as error:
            self.get_logger().warning(f"ignored an action: {error}")
            return
        frame = self._simulation.step(actions)
        self._version = message.policy_version
        self._step += 1
        self._publish(batch, frame)
        self._recorder.acted(self._step - 1, actions)
        self._record(batch, frame)
        if self._robot is not None:
            self._robot.publish()

    def _awaits(self, batch: Batch, message: Action) -> bool:
        in_turn = (message.batch, message.step) == (self._identity, self._step) and self._step < batch.horizon
        return in_turn and (self._step == 0 or message.policy_version == self._version)

    def _publish(self, batch: Batch, frame: Frame) -> None:
        self._observations.publish(observation_message(self._identity, batch, self._step, frame))

    def _record(self, batch: Batch, frame: Frame) -> None:
        """Record after publishing: the policy node is at work meanwhile."""
        self._recorder.observed(self._step, frame)
        if self._step == batch.horizon:
            self._episodes.publish(episodes_message(self._identity, self._version, self._recorder.episodes()))


def main() -> None:
    """Run the simulator node."""
    run(SimulatorNode)


if __name__ == "__main__":
    main()
