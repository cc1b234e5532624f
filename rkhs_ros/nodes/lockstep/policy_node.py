"""The policy node: answers observations with actions, and accepts new policies between batches."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from rkhs_interfaces import msg
from rkhs_interfaces.msg import Action, BatchProgress
from rkhs_interfaces.msg import Observation as ObservationMessage
from rkhs_interfaces.msg import Policy as PolicyMessage
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.base.threads import one_thread
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.diagnostics import Diagnostics
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, batch_fields, batch_of, observations_of
from rkhs_ros.nodes.core.names import namespaces
from rkhs_ros.nodes.core.newest_topic import NewestTopic
from rkhs_ros.nodes.core.parameters import declared, given, process, require_known, restarts
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from rkhs_ros.nodes.core.uniqueness import Uniqueness
from rkhs_ros.policies.messages import doubles, policy_message, policy_of
from rkhs_ros.policies.serving import Answer, Failed, Ignored, Observation, Refused, Reply, ServedPolicy, Session
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.policies.streams import Batch

MOST_SIMULATORS = 64


class SimulatorTopics:
    """The topics of one simulator: passes its observations to a session, and publishes the actions.

    Owns the session, and the batch in which the policy failed. Reuses the batch of the last observation and the message
    of the last action, because making new ones at each step takes longer.

    Args:
        node: the policy node.
        namespace: of the simulator.
    """

    def __init__(self, node: PolicyNode, namespace: str) -> None:
        self._node = node
        self.session = Session()
        self._failed: BatchProgress | None = None
        self._batch: Batch | None = None
        self._batch_fields: tuple[object, ...] = ()
        self._action = Action()
        self.actions = node.create_publisher(Action, f"{namespace}action", LOCKSTEP_QOS)
        node.create_subscription(ObservationMessage, f"{namespace}observation", self._observe, LOCKSTEP_QOS)

    def _observe(self, message: ObservationMessage) -> None:
        before = self.session.last
        match self._reply(message):
            case Answer() as answer:
                self._publish(answer)
                self._failed = None
                self._node.diagnostics.stuck = ""
                self._node.diagnostics.steps += answer is not before
            case Ignored(reason):
                self._node.diagnostics.skip(f"observation: {reason}")
            case Refused(reason):
                self._node.diagnostics.refuse(f"observation: {reason}")
            case Failed(reason):
                self._failed = BatchProgress(batch=message.batch, step=message.step, failure=reason)
                self._node.diagnostics.stuck = reason

    def _publish(self, answer: Answer) -> None:
        message = self._action
        message.batch, message.policy_version, message.step = answer.identity, answer.version, answer.step
        message.actions = doubles(answer.actions)
        self.actions.publish(message)

    def progress(self) -> BatchProgress:
        """Return the progress of the policy in the simulator's batch."""
        last = self.session.last
        return self._failed or (BatchProgress(batch=last.identity, step=last.step) if last else BatchProgress())

    def _reply(self, message: ObservationMessage) -> Reply:
        try:
            observation = self._observation_of(message)
        except ValueError as error:
            return Refused(str(error))
        return self.session.answer(observation, self._node.served)

    def _observation_of(self, message: ObservationMessage) -> Observation:
        """Return the observation in a message.

        Raises:
            ValueError: the shape is wrong, a value is not finite, or a number is out of range.
        """
        received = batch_fields(message)
        if self._batch is None or received != self._batch_fields:
            self._batch, self._batch_fields = batch_of(message), received
        batch = self._batch
        return Observation(
            identity=message.batch,
            version=message.policy_version,
            step=message.step,
            batch=batch,
            observations=observations_of(message, batch),
            over=message.over,
        )


class PolicyNode(ReportingNode):
    """Serves a policy.

    Owns the policy in service, from a learner or from a file; a policy from a file is never replaced. Owns no random
    state: the exploration of an episode follows from the batch's seed.
    """

    def __init__(self) -> None:
        super().__init__("policy")

    def open(self) -> None:
        """Declare the parameters and open topics and service.

        Raises:
            ValueError: an unknown parameter, or an invalid policy file.
        """
        self._message = PolicyMessage()  # of the policy in service
        tree = given(self)
        simulators = declared(self, tree, "simulators", 1, "number of simulator nodes to serve")
        if not 1 <= simulators <= MOST_SIMULATORS:
            raise ValueError(f"simulators: expected 1 to {MOST_SIMULATORS}, got {simulators}")
        again, own_process = restarts(self, tree), process(self, tree)
        self.served = self._from_file(tree)
        self._simulators = [SimulatorTopics(self, namespace) for namespace in namespaces(simulators)]
        topics = [f"{namespace}observation" for namespace in namespaces(simulators)]
        self.diagnostics = Diagnostics(self, again, self._report, topics)
        self._uniqueness = Uniqueness(self, own_process)
        self._in_service = NewestTopic(self, PolicyMessage, "policy_in_service")
        if self.served:
            self._in_service.offer(partial(policy_message, msg, self.served.policy, self.served.version))
        self.create_service(SetPolicy, "set_policy", self._set_policy)
        source = "with the policy of a file, without exploration noise" if self.served else "for a learner's policy"
        self.get_logger().info(f"ready {source}; serves {simulators} simulator{'s' * (simulators > 1)}")

    def heartbeat(self) -> float:
        """Publish the status and the policy in service if due; return the seconds until the next ones."""
        self._uniqueness.check()
        return min(self.diagnostics.heartbeat(), self._in_service.heartbeat())

    @property
    def _version(self) -> int:
        return self.served.version if self.served else 0

    def _report(self) -> dict[str, object]:
        answers = [simulator.session.last for simulator in self._simulators]
        batches = " ".join(str(answer.identity) if answer else "0" for answer in answers)
        steps = " ".join(str(answer.step) if answer else "-" for answer in answers)
        return {"serving version": self._version, "batch": batches, "step": steps}

    def _from_file(self, tree: dict[str, object]) -> ServedPolicy | None:
        about = "policy.npz to serve, without exploration noise; empty to wait for a learner's policy"
        file = declared(self, tree, "policy_file", "", about)
        require_known(tree, "policy_file")
        if not file:
            return None
        try:
            policy, _ = load_policy(Path(file))
        except FileNotFoundError as error:
            raise ValueError(f"policy_file: expected a policy.npz, but '{file}' does not exist") from error
        return ServedPolicy(policy, version=0, explores=False)

    def _set_policy(self, request: SetPolicy.Request, response: SetPolicy.Response) -> SetPolicy.Response:
        with self.diagnostics.accepting(response, "set_policy"):
            self.served, self._message = self._accept(request.policy), request.policy
            self._in_service.offer(lambda: self._message)
        response.version = self._version
        response.instance = self._uniqueness.instance
        response.progress = [simulator.progress() for simulator in self._simulators]
        response.connected = all(simulator.actions.get_subscription_count() > 0 for simulator in self._simulators)
        return response

    def _accept(self, message: PolicyMessage) -> ServedPolicy:
        served = self.served
        if served is not None and not served.explores:
            raise ValueError("policy: expected none from a learner, because this node serves the policy of a file")
        policy = policy_of(message)
        if served is not None and message.version == served.version:
            require(message == self._message, "version", "a new version for a new policy", message.version)
        return ServedPolicy(policy, message.version)


def main() -> None:
    """Run the policy node."""
    with one_thread():
        run(PolicyNode, "policy", serve)


if __name__ == "__main__":
    main()
