"""The policy node: answers observations with actions, and accepts new policies between batches."""

from __future__ import annotations

from pathlib import Path

from builtin_interfaces.msg import Time

from rkhs_interfaces.msg import Action
from rkhs_interfaces.msg import Observation as ObservationMessage
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.core.diagnostics import Diagnostics
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, batch_fields, batch_of, observations_of
from rkhs_ros.nodes.core.parameters import declared, given, require_known
from rkhs_ros.nodes.core.publishers import is_answered
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from rkhs_ros.policies.messages import doubles, policy_of
from rkhs_ros.policies.serving import Answer, Failed, Ignored, Observation, Reply, ServedPolicy, Session
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.policies.streams import Batch


class SimulatorTopics:
    """The topics of the simulator: passes its observations to a session, and publishes the actions.

    Owns the session. Reuses the batch of the last observation and the message of the last action, because making new
    ones at each step takes longer.
    """

    def __init__(self, node: PolicyNode) -> None:
        self._node = node
        self.session = Session()
        self._batch: Batch | None = None
        self._batch_fields: tuple[object, ...] = ()
        self._action = Action()
        self._actions = node.create_publisher(Action, "action", LOCKSTEP_QOS)
        node.create_subscription(ObservationMessage, "observation", self._observe, LOCKSTEP_QOS)

    def _observe(self, message: ObservationMessage) -> None:
        diagnostics = self._node.diagnostics
        match self._reply(message):
            case Answer() as answer:
                self._publish(answer, message.stamp)
                diagnostics.stuck = ""
                diagnostics.steps += 1
            case Ignored(reason):
                diagnostics.skip(f"observation: {reason}")
            case Failed(reason):
                diagnostics.stuck = reason
                failed = Action(batch=message.batch, policy_version=message.policy_version, step=message.step)
                failed.failure = f"the policy cannot act: {reason}"
                self._actions.publish(failed)

    def _publish(self, answer: Answer, stamp: Time) -> None:
        message = self._action
        message.stamp = stamp
        message.batch, message.policy_version, message.step = answer.identity, answer.version, answer.step
        message.actions = doubles(answer.actions)
        self._actions.publish(message)

    def _reply(self, message: ObservationMessage) -> Reply:
        try:
            observation = self._observation_of(message)
        except ValueError as error:
            return Failed(str(error))
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
        tree = given(self)
        self.served = self._from_file(tree)
        self._simulator = SimulatorTopics(self)
        self.diagnostics = Diagnostics(self, self._report)
        self.create_service(SetPolicy, "set_policy", self._set_policy)
        source = "with the policy of a file, without exploration noise" if self.served else "for a learner's policy"
        self.get_logger().info(f"ready {source}")

    def heartbeat(self) -> float:
        """Publish the status if due; return the seconds until the next one."""
        return self.diagnostics.heartbeat()

    def _report(self) -> dict[str, object]:
        last, version = self._simulator.session.last, self.served.version if self.served else 0
        return {"serving version": version, "batch": last.identity if last else 0, "step": last.step if last else "-"}

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
        if not is_answered(self, "action", "observation"):
            response.message = "no simulator subscribes to the actions"
            return response
        with self.diagnostics.accepting(response, "set_policy"):
            if self.served is not None and not self.served.explores:
                raise ValueError("policy: expected none from a learner, because this node serves the policy of a file")
            self.served = ServedPolicy(policy_of(request.policy), request.policy.version)
        return response


def main() -> None:
    """Run the policy node."""
    run(PolicyNode, "policy", serve)


if __name__ == "__main__":
    main()
