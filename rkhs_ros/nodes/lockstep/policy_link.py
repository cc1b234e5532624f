"""The learner's client of the policy node."""

from functools import partial

from rclpy.node import Node

from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.core.messages import set_policy_request
from rkhs_ros.nodes.core.names import fresh_number
from rkhs_ros.nodes.core.peers import Peers
from rkhs_ros.policies.gaussian import GaussianPolicy

NAME = "policy"


class PolicyLink:
    """The learner's client of the policy node.

    Owns the policy in service and its version.

    Args:
        node: the learner node.
        peers: the learner's calls to other nodes.
    """

    def __init__(self, node: Node, peers: Peers) -> None:
        self.version = 0
        self._policy: GaussianPolicy | None = None
        self._peers = peers
        self._set_policy = node.create_client(SetPolicy, "set_policy")

    def wait(self) -> None:
        """Wait until the policy node offers its service.

        Raises:
            SilentError: the node does not offer it in time.
        """
        self._peers.wait_for_service(self._set_policy, NAME)

    def serve(self, policy: GaussianPolicy) -> None:
        """Send a policy to the policy node, unless the node serves it already.

        Raises:
            SilentError: the node does not answer in time.
            ValueError: the node refuses the policy.
        """
        if policy is not self._policy:
            version = fresh_number()
            request = set_policy_request(policy, version)
            ask = partial(self._peers.call, self._set_policy, request, NAME, repeatable=True)
            self._peers.call_until_accepted(ask, NAME)
            self._policy, self.version = policy, version
