"""The simulator node: serves any Gymnasium environment with continuous actions over topics."""

import json
import time
from contextlib import closing

import sim_nodes.envs  # noqa: F401  # registers the tasks
from rkhs_interfaces import msg
from rkhs_interfaces.msg import Action, Episodes, Observation
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.base.endings import RunError, SilentError
from rkhs_ros.base.validation import require, truncated
from rkhs_ros.nodes.core.diagnostics import Diagnostics, unconnected
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, batch_of, describe, observation_message
from rkhs_ros.nodes.core.parameters import declare, given, require_known
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from rkhs_ros.policies.messages import shaped
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.messages import episodes_message
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.inline_runner import EpisodeRecorder
from rkhs_ros.rollouts.simulation import Frame, Simulation
from rkhs_ros.runs.config import environment_from


class SimulatorNode(ReportingNode):
    """Publishes observations, executes actions, and publishes the resulting episodes.

    Owns the environment, the current step, and the running episodes. A step ends when its action arrives. The
    node accepts only the action of the current batch, step and policy. If the environment or the policy fails, the
    batch ends with a message that says why.
    """

    def open(self) -> None:
        """Make the environment and open topics and services."""
        tree = given(self, needs_section=True)
        require_known(tree, "environment")
        environment = environment_from(tree.get("environment", {}))
        declare(self, environment.entries())
        simulation = Simulation(environment.id, environment.options, environment.num_envs)
        self._simulation = self.resources.enter_context(closing(simulation))
        self._batch: Batch | None = None  # that runs
        self._identity = 0
        self._step = 0
        self._version = 0
        self._timeout = 0.0  # seconds without an action; 0 for no limit
        self._published_at = 0.0  # monotonic time, seconds
        self._observations = self.create_publisher(Observation, "observation", LOCKSTEP_QOS)
        self._episodes = self.create_publisher(Episodes, "episodes", LOCKSTEP_QOS)
        self.diagnostics = Diagnostics(self, self._report)
        self.create_subscription(Action, "action", self._act, LOCKSTEP_QOS)
        self.create_service(StartEpisodes, "start_episodes", self._start)
        self.create_service(DescribeTask, "describe_task", self._describe)
        self.get_logger().info(f"ready for episodes of {self._simulation.environment}")

    def heartbeat(self) -> float:
        """Publish the status if due; return the seconds until the next one."""
        now = time.monotonic()
        if self._batch is not None and 0 < self._timeout < now - self._published_at:
            raise SilentError(f"the policy node did not act within {self._timeout:g} s")
        return self.diagnostics.heartbeat()

    def _report(self) -> dict[str, object]:
        return {"serving version": self._version, "batch": self._identity, "step": self._step}

    def _describe(self, request: DescribeTask.Request, response: DescribeTask.Response) -> DescribeTask.Response:
        return describe(self._simulation, request.num_envs)

    def _start(self, request: StartEpisodes.Request, response: StartEpisodes.Response) -> StartEpisodes.Response:
        if message := unconnected(self, "observation", "action"):
            response.message = message
            return response
        with self.diagnostics.accepting(response, "start_episodes"):
            ours = (self._simulation.environment, json.dumps(self._simulation.options))
            requested = (request.environment, request.options)
            require(requested == ours, "task", " with options ".join(ours), " with options ".join(requested))
            self._begin(request, batch_of(request))
        return response

    def _begin(self, request: StartEpisodes.Request, batch: Batch) -> None:
        seeds, failure = request.environment_seeds.tolist(), ""
        try:
            frame = self._simulation.start(batch, seeds)
        except RunError as error:
            failure = str(error)
        self._identity, self._version, self._timeout = request.batch, request.policy_version, request.timeout
        self._batch, self._step, self.diagnostics.stuck = batch, 0, ""
        self._recorder = None if seeds else EpisodeRecorder(batch, self._simulation.spaces)
        if failure:
            self._fail(failure)
            return
        self._publish(batch, frame)

    def _fail(self, reason: str) -> None:
        self._batch = None
        self.diagnostics.stuck = reason
        self._episodes.publish(Episodes(batch=self._identity, policy_version=self._version, failure=reason))

    def _act(self, message: Action) -> None:
        batch = self._batch
        awaited, got = (
            (self._identity, self._step, self._version),
            (message.batch, message.step, message.policy_version),
        )
        if batch is None or got != awaited:
            names = "batch {}, step {}, policy version {}"
            self.diagnostics.skip(f"action: expected {names.format(*awaited)}, got {names.format(*got)}")
            return
        try:
            if message.failure:
                raise RunError(f"{self._simulation.environment}: {truncated(message.failure)}")
            actions = shaped(message.actions, (batch.num_envs, self._simulation.spaces.action_dim), "actions")
            frame = self._simulation.step(actions)
        except (ValueError, RunError) as error:
            self._fail(str(error))
            return
        self._step += 1
        self._publish(batch, frame, actions)
        self.diagnostics.steps += 1

    def _publish(self, batch: Batch, frame: Frame, actions: Array | None = None) -> None:
        """Publish a step, and record it while the policy node computes.

        Batches with seeds of their own are not recorded; their client has all observations.
        """
        self._observations.publish(observation_message(self._identity, self._version, batch, self._step, frame))
        self._batch = None if frame.is_over else batch
        self._published_at = time.monotonic()
        if self._recorder is None:
            return
        if actions is not None:
            self._recorder.acted(self._step - 1, actions)
        self._recorder.observed(self._step, frame)
        if frame.is_over:
            episodes = self._recorder.episodes()
            self._episodes.publish(episodes_message(msg, self._identity, self._version, episodes))


def main() -> None:
    """Run the simulator node."""
    run(SimulatorNode, "simulator", serve)


if __name__ == "__main__":
    main()
