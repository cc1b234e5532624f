"""The learner's client of the policy node."""

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
    """The learner's client of the policy node.

    Owns the policy to serve, its version, the process that answered last, and that process's progress.

    Args:
        node: the learner node.
        peers: the learner's calls to other nodes.
        several: whether there are several simulators, some of which may disappear after all have been connected.
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
        """Wait until the policy node offers its service.

        Raises:
            PeerError: the node does not offer it in time.
        """
        self._peers.wait_for_service(self._set_policy, NAME)

    def serve(self, policy: GaussianPolicy) -> None:
        """Send a policy to the policy node, unless the node serves it already."""
        if policy is not self.policy:
            self.policy, self.version = policy, fresh_number()
            self.push(policy)

    def push(self, policy: GaussianPolicy) -> bool:
        """Send the policy, possibly again.

        Returns:
            Whether the policy node has lost the running batches: another process answers, or the version has changed.
        """
        ask = partial(self._peers.call_until_accepted, partial(self._set, policy), NAME)
        before = (self._instance, self.version)
        response = ask() if self._has_met_all else self._peers.call_until_connected(ask, NAME)
        self._has_met_all = self._several
        self._instance, self.progress = response.instance, response.progress
        return (self._instance, self.version) != before

    def _set(self, policy: GaussianPolicy) -> SetPolicy.Response:
        """Send the policy; if the node serves another learner's policy under this version, choose a new version."""
        response = self._peers.call(self._set_policy, set_policy_request(policy, self.version), NAME)
        if not response.accepted and response.version == self.version:
            self.version = fresh_number()
            self._node.get_logger().warning(
                f"the {NAME} node serves a policy of another client as version {response.version}; "
                f"this one is now version {self.version}"
            )
        return response
