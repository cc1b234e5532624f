"""The policy node: answers observations with actions, and takes new policies between batches."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from rkhs_interfaces.msg import Action, Observation
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.experiments.launcher import namespaces
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, batch_of, doubles, matrix, policy_of
from rkhs_ros.nodes.parameters import declared, given
from rkhs_ros.nodes.spin import run
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.validation import hint

MOST_SIMULATORS = 64


class Seat:
    """Where one simulator is served.

    Owns the batch under way. A batch is served by one policy from its first step to its last.

    Args:
        node: the policy node.
        namespace: the simulator's.
    """

    def __init__(self, node: PolicyNode, namespace: str) -> None:
        self._node = node
        self._acting: Acting | None = None
        self._version = 0
        self._batch = 0
        self.actions = node.create_publisher(Action, f"{namespace}action", LOCKSTEP_QOS)
        node.create_subscription(Observation, f"{namespace}observation", self._observe, LOCKSTEP_QOS)

    def _observe(self, message: Observation) -> None:
        try:
            if message.step == 0 and message.batch > self._batch:
                self._begin(message)
            acting = self._acting
            if acting is not None and message.batch == self._batch and message.step < acting.batch.horizon:
                self._act(acting, message)
        except ValueError as error:
            self._node.get_logger().warning(f"ignored an observation: {error}")

    def _begin(self, message: Observation) -> None:
        self._acting, self._version = self._node.acting(batch_of(message))
        self._batch = message.batch

    def _act(self, acting: Acting, message: Observation) -> None:
        rows = acting.batch.rows
        columns = max(len(message.observations) // rows, 1)
        actions = acting(message.step, matrix(message.observations, rows, columns, "observations"))
        numbers = {"batch": message.batch, "step": message.step, "policy_version": self._version}
        self.actions.publish(Action(**numbers, actions=doubles(actions)))


class PolicyNode(Node):
    """Serves a policy.

    Owns the policy in service. Does not own any random state: the exploration of an episode follows from the
    batch's seed.
    """

    def __init__(self) -> None:
        """Declare the parameters and open topics and service.

        Raises:
            ValueError: an unknown parameter, or a policy file that cannot be used.
        """
        super().__init__("policy", automatically_declare_parameters_from_overrides=True)
        self._newest: GaussianPolicy | None = None
        self._version = 0
        self._fixed = False
        tree = given(self)
        simulators = declared(self, tree, "simulators", 1, "simulator nodes to serve")
        if not 1 <= simulators <= MOST_SIMULATORS:
            raise ValueError(f"simulators: expected 1 to {MOST_SIMULATORS}, got {simulators}")
        self._load(tree)
        self._seats = [Seat(self, namespace) for namespace in namespaces(simulators)]
        self.create_service(SetPolicy, "set_policy", self._set_policy)

    def acting(self, batch: Batch) -> tuple[Acting, int]:
        """Return the policy in service, ready to act in a batch, and its version.

        Raises:
            ValueError: there is none yet.
        """
        if self._newest is None:
            raise ValueError("expected a policy before the first observation, got none")
        return Acting(self._newest, batch, explore=batch.explore and not self._fixed), self._version

    def _load(self, tree: dict[str, object]) -> None:
        about = "policy.npz to serve alone, noise-free; empty to wait for a learner's policy"
        file = declared(self, tree, "policy_file", "", about)
        if tree:
            name = next(iter(tree))
            raise ValueError(f"unknown key '{name}', {hint(name, {'policy_file': None})}")
        if file:
            try:
                self._newest, _ = load_policy(Path(file))
            except FileNotFoundError as error:
                raise ValueError(f"policy_file: expected a policy.npz, got '{file}', which does not exist") from error
            self._fixed = True

    def _set_policy(self, request: SetPolicy.Request, response: SetPolicy.Response) -> SetPolicy.Response:
        try:
            if self._fixed:
                raise ValueError("policy: expected none from a learner, this node serves the policy of a file")
            self._newest, self._version = policy_of(request.policy), request.policy.version
            response.accepted = True
        except (ValueError, TypeError) as error:
            response.message = str(error)
            self.get_logger().warning(f"refused a policy: {error}")
        response.version = self._version
        response.connected = all(seat.actions.get_subscription_count() > 0 for seat in self._seats)
        return response


def main() -> None:
    """Run the policy node."""
    run(PolicyNode)


if __name__ == "__main__":
    main()
