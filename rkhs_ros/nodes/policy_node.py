"""The policy node: answers observations with actions, and takes new policies between batches."""

from __future__ import annotations

from pathlib import Path

from rkhs_interfaces.msg import Action, BatchProgress
from rkhs_interfaces.msg import Observation as ObservationMessage
from rkhs_interfaces.msg import Policy as PolicyMessage
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.diagnostics import Diagnostics
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, batch_of, observations_of
from rkhs_ros.nodes.names import namespaces
from rkhs_ros.nodes.parameters import declared, given, instance, require_known, restarts
from rkhs_ros.nodes.spin import ReportingNode, run, serve
from rkhs_ros.nodes.uniqueness import Uniqueness
from rkhs_ros.policies.messages import doubles, policy_of
from rkhs_ros.policies.serving import Answer, Failed, Ignored, Observation, Refused, Reply, ServedPolicy, Session
from rkhs_ros.policies.storage import load_policy

MOST_SIMULATORS = 64


class SimulatorTopics:
    """The topics of one simulator: what it shows goes to its session, the answers go back.

    Owns the session, and in which batch the policy failed.

    Args:
        node: the policy node.
        namespace: the simulator's.
    """

    def __init__(self, node: PolicyNode, namespace: str) -> None:
        self._node = node
        self.session = Session()
        self._failed: BatchProgress | None = None
        self.actions = node.create_publisher(Action, f"{namespace}action", LOCKSTEP_QOS)
        node.create_subscription(ObservationMessage, f"{namespace}observation", self._observe, LOCKSTEP_QOS)

    def _observe(self, message: ObservationMessage) -> None:
        before = self.session.last
        match self._reply(message):
            case Answer() as answer:
                self._failed = None
                self._node.diagnostics.stuck = ""
                self.actions.publish(_action_message(answer))
                self._node.diagnostics.steps += answer is not before
            case Ignored(reason):
                self._node.diagnostics.pass_over(f"an observation: {reason}")
            case Refused(reason):
                self._node.diagnostics.refuse(f"an observation: {reason}")
            case Failed(reason):
                self._failed = BatchProgress(batch=message.batch, step=message.step, failure=reason)
                self._node.diagnostics.stuck = reason

    def progress(self) -> BatchProgress:
        """Return how far the policy came with the simulator's batch."""
        last = self.session.last
        return self._failed or (BatchProgress(batch=last.identity, step=last.step) if last else BatchProgress())

    def _reply(self, message: ObservationMessage) -> Reply:
        try:
            observation = _observation_of(message)
        except ValueError as error:
            return Refused(str(error))
        return self.session.answer(observation, self._node.served)


class PolicyNode(ReportingNode):
    """Serves a policy.

    Owns the policy in service, of a learner or of a file; one of a file stays. Does not own any random state: the
    exploration of an episode follows from the batch's seed.
    """

    def __init__(self) -> None:
        super().__init__("policy")

    def open(self) -> None:
        """Declare the parameters and open topics and service.

        Raises:
            ValueError: an unknown parameter, or a policy file that cannot be used.
        """
        self._message = PolicyMessage()  # that the policy in service came by
        tree = given(self)
        simulators = declared(self, tree, "simulators", 1, "simulator nodes to serve")
        if not 1 <= simulators <= MOST_SIMULATORS:
            raise ValueError(f"simulators: expected 1 to {MOST_SIMULATORS}, got {simulators}")
        again, number = restarts(self, tree), instance(self, tree)
        self.served = self._from_file(tree)
        self._simulators = [SimulatorTopics(self, namespace) for namespace in namespaces(simulators)]
        topics = [f"{namespace}observation" for namespace in namespaces(simulators)]
        self.diagnostics = Diagnostics(self, again, self._report, topics)
        self._uniqueness = Uniqueness(self, number)
        self.create_service(SetPolicy, "set_policy", self._set_policy)
        whose = "with the policy of a file, noise-free" if self.served else "for a learner's policy"
        self.get_logger().info(f"ready {whose}; serves {simulators} simulator{'s' * (simulators > 1)}")

    def heartbeat(self) -> float:
        """Report; return the seconds until the next report."""
        self._uniqueness.check()
        return self.diagnostics.heartbeat()

    @property
    def _version(self) -> int:
        return self.served.version if self.served else 0

    def _report(self) -> dict[str, object]:
        answers = [simulator.session.last for simulator in self._simulators]
        batches = " ".join(str(answer.identity) if answer else "0" for answer in answers)
        steps = " ".join(str(answer.step) if answer else "-" for answer in answers)
        return {"serving version": self._version, "batch": batches, "step": steps}

    def _from_file(self, tree: dict[str, object]) -> ServedPolicy | None:
        about = "policy.npz to serve alone, noise-free; empty to wait for a learner's policy"
        file = declared(self, tree, "policy_file", "", about)
        require_known(tree, "policy_file")
        if not file:
            return None
        try:
            policy, _ = load_policy(Path(file))
        except FileNotFoundError as error:
            raise ValueError(f"policy_file: expected a policy.npz, got '{file}', which does not exist") from error
        return ServedPolicy(policy, version=0, explores=False)

    def _set_policy(self, request: SetPolicy.Request, response: SetPolicy.Response) -> SetPolicy.Response:
        try:
            self.served, self._message = self._accept(request.policy), request.policy
            response.accepted = True
        except (ValueError, TypeError) as error:
            response.message = str(error)
            self.diagnostics.refuse(f"a policy: {error}")
        response.version = self._version
        response.instance = self._uniqueness.instance
        response.progress = [simulator.progress() for simulator in self._simulators]
        response.connected = all(simulator.actions.get_subscription_count() > 0 for simulator in self._simulators)
        return response

    def _accept(self, message: PolicyMessage) -> ServedPolicy:
        served = self.served
        if served is not None and not served.explores:
            raise ValueError("policy: expected none from a learner, this node serves the policy of a file")
        policy = policy_of(message)
        if served is not None and message.version == served.version:
            require(message == self._message, "version", "another one for another policy", message.version)
        return ServedPolicy(policy, message.version)


def _observation_of(message: ObservationMessage) -> Observation:
    """Return the observation that a message carries.

    Raises:
        ValueError: it is misshapen, not finite, or a number is out of range.
    """
    batch = batch_of(message)
    return Observation(
        identity=message.batch,
        version=message.policy_version,
        step=message.step,
        batch=batch,
        observations=observations_of(message, batch),
        over=message.over,
    )


def _action_message(answer: Answer) -> Action:
    return Action(
        batch=answer.identity,
        policy_version=answer.version,
        step=answer.step,
        actions=doubles(answer.actions),
    )


def main() -> None:
    """Run the policy node."""
    run(PolicyNode, "policy", serve)


if __name__ == "__main__":
    main()
