"""The policy node as the learner sees it."""

from __future__ import annotations

from functools import partial

from rclpy.node import Node

from rkhs_interfaces.msg import BatchProgress
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.core.messages import set_policy_request
from rkhs_ros.nodes.core.names import fresh_number
from rkhs_ros.nodes.core.peers import Peers
from rkhs_ros.policies.gaussian import GaussianPolicy

NAME = "policy"


class PolicyLink:
    """The policy node as the learner sees it.

    Owns the policy it is to serve, its version, which process of the node answered last, and how far that one was.

    Args:
        node: the learner node.
        peers: how it calls others.
        several: whether there are several simulators, of which some may be lost once all have been met.
    """

    def __init__(self, node: Node, peers: Peers, *, several: bool) -> None:
        self._several = several
        self._has_met_all = False
        self.version = 0
        self.progress: list[BatchProgress] = []
        self.policy: GaussianPolicy | None = None
        self._instance = 0
        self._node = node
        self._peers = peers
        self._set_policy = node.create_client(SetPolicy, "set_policy")

    def wait(self) -> None:
        """Wait until the policy node is there."""
        self._peers.wait_for_service(self._set_policy, NAME)

    def serve(self, policy: GaussianPolicy) -> None:
        """Have the policy node serve a policy, if it does not serve it already."""
        if policy is not self.policy:
            self.policy, self.version = policy, fresh_number()
            self.push(policy)

    def push(self, policy: GaussianPolicy) -> bool:
        """Send the policy in service, perhaps again.

        Returns:
            Whether the policy node knows nothing of batches under way: another process answers than before, or the
            policy got another version.
        """
        ask = partial(self._peers.call_until_accepted, partial(self._set, policy), NAME)
        before = (self._instance, self.version)
        response = ask() if self._has_met_all else self._peers.call_until_connected(ask, NAME)
        self._has_met_all = self._several
        self._instance, self.progress = response.instance, response.progress
        return (self._instance, self.version) != before

    def _set(self, policy: GaussianPolicy) -> SetPolicy.Response:
        """Send the policy; if the node serves another one by its version, somebody else's, choose another version."""
        response = self._peers.call(self._set_policy, set_policy_request(policy, self.version), NAME)
        if not response.accepted and response.version == self.version:
            self.version = fresh_number()
            self._node.get_logger().warning(
                f"somebody else had the {NAME} node serve another policy as version {response.version}; "
                f"this one is now version {self.version}"
            )
        return response
