"""The policy node: answers observations with actions, and takes new policies between batches."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from rkhs_interfaces.msg import Action, Observation
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, batch_of, doubles, matrix, policy_of
from rkhs_ros.nodes.parameters import declared, given
from rkhs_ros.nodes.spin import run
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rkhs.validation import hint


class PolicyNode(Node):
    """Serves a policy.

    Owns the policy in service and the batch it acts in. Does not own any random state: the exploration of an
    episode follows from the batch's seed. A batch is served by one policy from its first step to its last.
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
        self._load(given(self))
        self._acting: Acting | None = None
        self._acting_version = 0
        self._batch = 0
        self._actions = self.create_publisher(Action, "action", LOCKSTEP_QOS)
        self.create_subscription(Observation, "observation", self._observe, LOCKSTEP_QOS)
        self.create_service(SetPolicy, "set_policy", self._set_policy)

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
        response.connected = self._actions.get_subscription_count() > 0
        return response

    def _observe(self, message: Observation) -> None:
        try:
            if message.step == 0 and message.batch > self._batch:
                self._begin(message)
            if message.batch == self._batch and message.step < message.horizon and self._acting is not None:
                self._act(self._acting, message)
        except ValueError as error:
            self.get_logger().warning(f"ignored an observation: {error}")

    def _begin(self, message: Observation) -> None:
        if self._newest is None:
            raise ValueError("expected a policy before the first observation, got none")
        batch = batch_of(message)
        noise_free = Acting(self._newest, exploration=None)
        self._acting = noise_free if self._fixed else Acting.start(self._newest, batch)
        self._acting_version = self._version
        self._batch = message.batch

    def _act(self, acting: Acting, message: Observation) -> None:
        columns = acting.policy.mean.input_dim
        observations = matrix(message.observations, message.rows, columns, "observations")
        actions = acting(message.step, observations)
        self._actions.publish(
            Action(
                batch=message.batch,
                step=message.step,
                policy_version=self._acting_version,
                actions=doubles(actions),
            )
        )


def main() -> None:
    """Run the policy node."""
    run(PolicyNode)


if __name__ == "__main__":
    main()
