"""The policy node: answers observations with actions, and accepts new policies between batches."""

from pathlib import Path

from rkhs_interfaces.msg import Action, Observation as ObservationMessage
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.base.endings import RunError
from rkhs_ros.nodes.core.diagnostics import Diagnostics, unconnected
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, batch_of, observations_of
from rkhs_ros.nodes.core.parameters import declared, given, require_known
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from rkhs_ros.policies.messages import doubles, policy_of
from rkhs_ros.policies.serving import OtherBatchError, Place, ServedPolicy, Session
from rkhs_ros.policies.storage import load_policy


class PolicyNode(ReportingNode):
    """Serves a policy.

    Owns the policy in service, from a learner or from a file, and the session with the simulator; a policy from a file
    is never replaced. Owns no random state: the exploration of an episode follows from the batch's seed.
    """

    def open(self) -> None:
        """Read the policy file, if there is one, and open topics and service."""
        self._served = self._from_file(given(self))
        self._session = Session()
        self._actions = self.create_publisher(Action, "action", LOCKSTEP_QOS)
        self.create_subscription(ObservationMessage, "observation", self._observe, LOCKSTEP_QOS)
        self.diagnostics = Diagnostics(self, self._report)
        self.create_service(SetPolicy, "set_policy", self._set_policy)
        source = "with the policy of a file, without exploration noise" if self._served else "for a learner's policy"
        self.get_logger().info(f"ready {source}")

    def _observe(self, message: ObservationMessage) -> None:
        place = {"batch": message.batch, "policy_version": message.policy_version, "step": message.step}
        try:
            batch = batch_of(message)
            observations = observations_of(message, batch)
            actions = self._session.answer(Place(*place.values()), batch, observations, self._served, over=message.over)
        except OtherBatchError as error:
            self.diagnostics.skip(f"observation: {error}")
        except (ValueError, RunError) as error:
            self.diagnostics.stuck = str(error)
            self._actions.publish(Action(failure=f"the policy cannot act: {error}", **place))
        else:
            if actions is not None:
                self._actions.publish(Action(stamp=message.stamp, actions=doubles(actions), **place))
                self.diagnostics.stuck = ""
                self.diagnostics.steps += 1

    def _report(self) -> dict[str, object]:
        last, version = self._session.last, self._served.version if self._served else 0
        return {"serving version": version, "batch": last.batch, "step": last.step if last.step >= 0 else "-"}

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
        if message := unconnected(self, "action", "observation"):
            response.message = message
            return response
        with self.diagnostics.accepting(response, "set_policy"):
            if self._served is not None and not self._served.explores:
                raise ValueError("policy: expected none from a learner, because this node serves the policy of a file")
            self._served = ServedPolicy(policy_of(request.policy), request.policy.version)
        return response


def main() -> None:
    """Run the policy node."""
    run(PolicyNode, "policy", serve)


if __name__ == "__main__":
    main()
