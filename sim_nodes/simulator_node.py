"""The simulator node: any Gymnasium environment with continuous actions behind topics."""

from __future__ import annotations

from rclpy.node import Node

from rkhs_interfaces.msg import Action, Observation
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.experiments.config import environment_from
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, batch_of, describe, matrix, observation_message
from rkhs_ros.nodes.parameters import declare, given
from rkhs_ros.nodes.spin import run
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.settings import Entry
from rkhs_ros.rkhs.validation import hint
from sim_nodes.simulation import Frame, Simulation


class SimulatorNode(Node):
    """Publishes observations and executes actions.

    Owns the environment and the step it waits at. Does not own the pace: the action is the clock. Only the
    action of the current batch and step is taken, so nothing is stepped twice.
    """

    def __init__(self) -> None:
        """Make the environment and open topics and services.

        Raises:
            ValueError: an unknown parameter, or an environment that cannot be served.
        """
        super().__init__("simulator", automatically_declare_parameters_from_overrides=True)
        self._simulation = self._make_simulation(given(self))
        self._batch: Batch | None = None
        self._identity = 0
        self._step = 0
        self._observations = self.create_publisher(Observation, "observation", LOCKSTEP_QOS)
        self.create_subscription(Action, "action", self._act, LOCKSTEP_QOS)
        self.create_service(StartEpisodes, "start_episodes", self._start)
        self.create_service(DescribeTask, "describe_task", lambda _, response: describe(self._simulation, response))

    def _make_simulation(self, tree: dict[str, dict[str, object]]) -> Simulation:
        for name in tree:
            if name != "environment":
                raise ValueError(f"unknown key '{name}', {hint(name, {'environment.id': None})}")
        environment = environment_from(tree.get("environment", {}))
        declare(self, [Entry("environment.id", environment.id, {"description": "Gymnasium id of the environment"})])
        return Simulation(environment.id, environment.options)

    def _start(self, request: StartEpisodes.Request, response: StartEpisodes.Response) -> StartEpisodes.Response:
        try:
            batch = batch_of(request)
            frame = self._simulation.start(batch)
        except ValueError as error:
            response.message = str(error)
            return response
        self._batch, self._identity, self._step = batch, request.batch, 0
        self._publish(batch, frame)
        response.accepted = True
        return response

    def _act(self, message: Action) -> None:
        batch = self._batch
        awaited = (message.batch, message.step) == (self._identity, self._step)
        if batch is None or not awaited or self._step == batch.horizon:
            return  # late, a duplicate, or of another batch
        try:
            actions = matrix(message.actions, batch.rows, self._simulation.action_dim, "actions")
        except ValueError as error:
            self.get_logger().warning(f"ignored an action: {error}")
            return
        self._step += 1
        self._publish(batch, self._simulation.step(actions))

    def _publish(self, batch: Batch, frame: Frame) -> None:
        self._observations.publish(observation_message(self._identity, batch, self._step, frame))


def main() -> None:
    """Run the simulator node."""
    run(SimulatorNode)


if __name__ == "__main__":
    main()
