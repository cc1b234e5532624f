"""The policy node as the learner sees it."""

from __future__ import annotations

import time
from functools import partial
from itertools import count

from rclpy.node import Node

from rkhs_interfaces.msg import BatchProgress
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.messages import set_policy_request
from rkhs_ros.nodes.peers import Peers
from rkhs_ros.policies.gaussian import GaussianPolicy

NAME = "policy"


class PolicyLink:
    """The policy node as the learner sees it.

    Owns the policy it is to serve, its version, which process of the node answered last, and how far that one was.

    Args:
        node: the learner node.
        peers: how it calls others.
    """

    def __init__(self, node: Node, peers: Peers) -> None:
        self.version = 0
        self.progress: list[BatchProgress] = []
        self._policy: GaussianPolicy | None = None
        self._instance = 0
        self._peers = peers
        # No result depends on the versions; no other learner, and not this one started again, uses the same ones.
        self._versions = count(time.time_ns())
        self._set_policy = node.create_client(SetPolicy, "set_policy")

    def wait(self) -> None:
        """Wait until the policy node is there."""
        self._peers.wait_for_service(self._set_policy, NAME)

    def serve(self, policy: GaussianPolicy) -> None:
        """Have the policy node serve a policy, if it does not serve it already."""
        if policy is not self._policy:
            self._policy, self.version = policy, next(self._versions)
            self.push(policy)

    def push(self, policy: GaussianPolicy) -> bool:
        """Send the policy in service, perhaps again; return whether another process answers than before."""
        request = set_policy_request(policy, self.version)
        ask = partial(self._peers.call_until_accepted, self._set_policy, request, NAME)
        response = self._peers.call_until_connected(ask, NAME)
        before, self._instance, self.progress = self._instance, response.instance, response.progress
        return self._instance != before
