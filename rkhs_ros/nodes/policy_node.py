"""The policy node: answers observations with actions, and takes new policies between batches."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np

from rkhs_interfaces.msg import Action, Observation
from rkhs_interfaces.msg import Policy as PolicyMessage
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.health import Health
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, batch_of, doubles, observations_of, policy_of
from rkhs_ros.nodes.names import namespaces
from rkhs_ros.nodes.parameters import declared, given, require_known, restarts
from rkhs_ros.nodes.spin import Server, forever, run
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rkhs.kernels import Array

MOST_SIMULATORS = 64
MEMORY = 64  # batches


class Seat:
    """Where one simulator is served.

    Owns the batch under way, its policy and its last answer. A batch is served by one policy from its first step to
    its last, no step left out; one that was left is not begun again, as its messages may come late.

    Args:
        node: the policy node.
        namespace: the simulator's.
    """

    def __init__(self, node: PolicyNode, namespace: str) -> None:
        self._node = node
        self._acting: Acting | None = None
        self._begun: deque[int] = deque(maxlen=MEMORY)
        self._version = 0
        self._next = 0  # step, the first without an answer
        self.batch = 0
        self.answer: Action | None = None
        self.actions = node.create_publisher(Action, f"{namespace}action", LOCKSTEP_QOS)
        node.create_subscription(Observation, f"{namespace}observation", self._observe, LOCKSTEP_QOS)

    def _observe(self, message: Observation) -> None:
        health, policy, version = self._node.health, self._node.policy, self._node.version
        begins = message.step == 0 and message.batch not in self._begun
        try:
            if begins and policy is not None and message.policy_version == version:
                self._begin(message, policy)
            elif self._acting is not None and (message.batch, message.policy_version) == (self.batch, self._version):
                self._go_on(message, self._acting)
            else:
                got = f"batch {message.batch}, step {message.step}, policy version {message.policy_version}"
                expected = f"batch {self.batch} or step 0 of a new one, policy version {version}"
                health.pass_over(f"an observation: expected {expected}, got {got}")
        except ValueError as error:
            health.refuse(f"an observation: {error}")

    def _begin(self, message: Observation, policy: GaussianPolicy) -> None:
        """Begin a batch; the one before is left only once the policy has an answer to what this one shows."""
        batch = batch_of(message)
        acting = Acting(policy, batch, explore=batch.explore and not self._node.fixed)
        answer = self._answer_to(message, acting, observations_of(message, batch))
        self._acting, self._version = acting, message.policy_version
        self.batch, self._next = message.batch, 0
        self._begun.append(message.batch)
        self._say(answer)

    def _go_on(self, message: Observation, acting: Acting) -> None:
        observations = observations_of(message, acting.batch)
        require(message.step <= self._next, "step", f"at most {self._next}, the next one", message.step)
        if message.over:
            return  # it asks for no action
        again = self.answer is not None and message.step == self.answer.step
        self._say(self.answer if again else self._answer_to(message, acting, observations))

    def _say(self, answer: Action) -> None:
        self.answer = answer
        self._next = max(self._next, answer.step + 1)
        self.actions.publish(answer)

    def _answer_to(self, message: Observation, acting: Acting, observations: Array) -> Action:
        actions = acting(message.step, observations)
        require(bool(np.isfinite(actions).all()), "actions", "finite numbers", "nan or infinity")
        self._node.health.steps += 1
        numbers = {"batch": message.batch, "step": message.step, "policy_version": message.policy_version}
        return Action(**numbers, actions=doubles(actions))


class PolicyNode(Server):
    """Serves a policy.

    Owns the policy in service, its version, which no other policy may have, and whether it is fixed, being of a file.
    Does not own any random state: the exploration of an episode follows from the batch's seed.
    """

    def __init__(self) -> None:
        """Declare the parameters and open topics and service.

        Raises:
            ValueError: an unknown parameter, or a policy file that cannot be used.
        """
        super().__init__("policy", automatically_declare_parameters_from_overrides=True)
        self.policy: GaussianPolicy | None = None
        self._message = PolicyMessage()
        self.version = 0
        self.fixed = False
        tree = given(self)
        simulators = declared(self, tree, "simulators", 1, "simulator nodes to serve")
        if not 1 <= simulators <= MOST_SIMULATORS:
            raise ValueError(f"simulators: expected 1 to {MOST_SIMULATORS}, got {simulators}")
        again = restarts(self, tree)
        self._load(tree)
        self._seats = [Seat(self, namespace) for namespace in namespaces(simulators)]
        self.health = Health(self, again, self._report)
        self.create_service(SetPolicy, "set_policy", self._set_policy)

    def look(self) -> float:
        """Report; return the seconds until the next report."""
        return self.health.look()

    def _report(self) -> dict[str, object]:
        answers = [seat.answer for seat in self._seats]
        steps = ["-" if answer is None else str(answer.step) for answer in answers]
        batches = [str(seat.batch) for seat in self._seats]
        return {"serving version": self.version, "batch": " ".join(batches), "step": " ".join(steps)}

    def _load(self, tree: dict[str, object]) -> None:
        about = "policy.npz to serve alone, noise-free; empty to wait for a learner's policy"
        file = declared(self, tree, "policy_file", "", about)
        require_known(tree, "policy_file")
        if file:
            try:
                self.policy, _ = load_policy(Path(file))
            except FileNotFoundError as error:
                raise ValueError(f"policy_file: expected a policy.npz, got '{file}', which does not exist") from error
            self.fixed = True

    def _set_policy(self, request: SetPolicy.Request, response: SetPolicy.Response) -> SetPolicy.Response:
        try:
            if self.fixed:
                raise ValueError("policy: expected none from a learner, this node serves the policy of a file")
            policy, version = policy_of(request.policy), request.policy.version
            if self.policy is not None and version == self.version:
                require(request.policy == self._message, "version", "another one for another policy", version)
            self.policy, self.version, self._message = policy, version, request.policy
            response.accepted = True
        except (ValueError, TypeError) as error:
            response.message = str(error)
            self.health.refuse(f"a policy: {error}")
        response.version = self.version
        response.instance = self.health.instance
        response.connected = all(seat.actions.get_subscription_count() > 0 for seat in self._seats)
        return response


def main() -> None:
    """Run the policy node."""
    run(PolicyNode, forever)


if __name__ == "__main__":
    main()
