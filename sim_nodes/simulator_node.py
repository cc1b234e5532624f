"""The simulator node: serves any Gymnasium environment with continuous actions over topics."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from rosgraph_msgs.msg import Clock

import sim_nodes.envs  # noqa: F401  # registers the tasks
from rkhs_interfaces import msg
from rkhs_interfaces.msg import Action, Episodes, Observation
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.base.endings import RunError
from rkhs_ros.base.threads import one_thread
from rkhs_ros.base.validation import require
from rkhs_ros.learning.messages import episodes_message
from rkhs_ros.nodes.core.arguments import require_section
from rkhs_ros.nodes.core.diagnostics import Diagnostics
from rkhs_ros.nodes.core.messages import (
    CLOCK_ENDS,
    LOCKSTEP_QOS,
    batch_of,
    clock_message,
    describe,
    observation_message,
    show,
)
from rkhs_ros.nodes.core.parameters import declare, declared, given, process, require_known, restarts
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from rkhs_ros.nodes.core.uniqueness import Uniqueness
from rkhs_ros.policies.messages import matrix
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.episode_recorder import EpisodeRecorder
from rkhs_ros.rollouts.simulation import Frame, Simulation
from rkhs_ros.runs.config import environment_from

if TYPE_CHECKING:
    from rkhs_ros.nodes.robot.robot_state import RobotState

MOST_STEPS = 2**40  # on a clock
Value = TypeVar("Value")
LISTENERS_PERIOD_S = 0.5  # between checks for subscribers of the clock
FIRST_RETRY_S, LONGEST_RETRY_S = 0.02, 1.0  # before an unanswered observation is repeated; exponential back-off


class SimulatorNode(ReportingNode):
    """Publishes observations, executes actions, and publishes the resulting episodes.

    Owns the environment, the current step, the running episodes and the clock. A step ends when its action arrives. The
    node accepts only the action of the current batch, step and policy, so that no step runs twice. It repeats an
    unanswered observation. If the environment fails, the batch stops, and `describe_task` reports the error.
    """

    def __init__(self) -> None:
        super().__init__("simulator")
        self._made = ExitStack()

    def open(self) -> None:
        """Make the environment and open topics and services.

        Raises:
            ValueError: an unknown parameter, or an unsupported environment.
        """
        require_section(self.get_fully_qualified_name(), sys.argv)
        tree = given(self)
        shown = declared(self, tree, "robot_state", False, "publish joint_states and robot_description for viewers")
        again, own_process = restarts(self, tree), process(self, tree)
        self._simulation = self._made.enter_context(closing(self._make_simulation(tree)))
        self._robot = self._make_robot_state() if shown else None
        self._batch: Batch | None = None
        self._identity = 0
        self._step = 0
        self._version = 0
        self._failure = ""
        self._clock_steps = 0
        self._clock_has_subscribers = False
        self._listeners_at = 0.0  # monotonic time, seconds
        self._newest: Observation | None = None  # message of the batch, updated at each step; None without a batch
        self._retry_s = FIRST_RETRY_S
        self._retry_at = 0.0
        self._result: Episodes | None = None
        self._observations = self.create_publisher(Observation, "observation", LOCKSTEP_QOS)
        self._episodes = self.create_publisher(Episodes, "episodes", LOCKSTEP_QOS)
        self._clock_ticks = self.create_publisher(Clock, "clock", LOCKSTEP_QOS)
        self.diagnostics = Diagnostics(self, again, self._report, ["action"])
        self._uniqueness = Uniqueness(self, own_process)
        self.create_subscription(Action, "action", self._act, LOCKSTEP_QOS)
        self.create_service(StartEpisodes, "start_episodes", self._start)
        self.create_service(DescribeTask, "describe_task", self._describe)
        self.get_logger().info(f"ready for episodes of {self._simulation.environment}")

    def destroy_node(self) -> None:
        """Close the environment and destroy the node."""
        self._made.close()
        super().destroy_node()

    def heartbeat(self) -> float:
        """Report, and repeat an unanswered observation; return the seconds until more is due."""
        self._uniqueness.check()
        wait = self.diagnostics.heartbeat()
        now = time.monotonic()
        if now >= self._listeners_at:
            self._clock_has_subscribers = self._clock_ticks.get_subscription_count() > 0
            self._listeners_at = now + LISTENERS_PERIOD_S
        if not self._is_waiting:
            return wait
        if now >= self._retry_at:
            self._observations.publish(self._newest)
            self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)
            self._retry_at = now + self._retry_s
        return min(wait, self._retry_at - now)

    def _make_simulation(self, tree: dict[str, dict[str, object]]) -> Simulation:
        require_known(tree, "environment")
        environment = environment_from(tree.get("environment", {}))
        declare(self, environment.entries())
        return Simulation(environment.id, environment.options, environment.num_envs)

    def _make_robot_state(self) -> RobotState:
        try:
            from rkhs_ros.nodes.robot.robot_state import RobotState
        except ImportError as error:
            raise ValueError(f"robot_state: expected the packages sensor_msgs and std_msgs, got: {error}") from error
        return RobotState(self, self._simulation)

    def _report(self) -> dict[str, object]:
        return {"serving version": self._version, "batch": self._identity, "step": self._step}

    def _describe(self, request: DescribeTask.Request, response: DescribeTask.Response) -> DescribeTask.Response:
        heard = self._observations.get_subscription_count() > 0 and self._episodes.get_subscription_count() > 0
        place = (self._identity, self._step, self._clock_steps)
        return describe(self._simulation, request.num_envs, *place, failure=self._failure, connected=heard)

    def _start(self, request: StartEpisodes.Request, response: StartEpisodes.Response) -> StartEpisodes.Response:
        with self.diagnostics.accepting(response, "start_episodes"):
            self._check_task(request)
            batch = batch_of(request)
            require(request.clock < MOST_STEPS, "clock", f"less than {MOST_STEPS} steps", request.clock)
            if self._batch is not None and request.batch == self._identity:
                current, requested = (self._version, self._batch), (request.policy_version, batch)
                expected = f"policy version and episodes {current}"
                require(requested == current, f"batch {request.batch}", expected, requested)
                seeds = request.environment_seeds.tolist()
                require(seeds == self._seeds, f"seeds of batch {request.batch}", "the same as before", "others")
                self._repeat()
            else:
                self._begin(request, batch)
        return response

    def _check_task(self, request: StartEpisodes.Request) -> None:
        ours = (self._simulation.environment, json.dumps(self._simulation.options))
        requested = (request.environment, request.options)
        require(requested == ours, "task", " with options ".join(ours), " with options ".join(requested))

    def _begin(self, request: StartEpisodes.Request, batch: Batch) -> None:
        seeds = request.environment_seeds.tolist()
        frame = self._attempt(partial(self._simulation.start, seeds=seeds), batch)
        self._seeds: list[int] = seeds
        self._batch, self._identity, self._version = batch, request.batch, request.policy_version
        self._step, self._result = 0, None
        self._clock_steps = max(self._clock_steps, request.clock)
        self._recorder = None if seeds else EpisodeRecorder(batch, self._simulation.spaces)
        if frame is not None:
            self._publish(observation_message(self._identity, self._version, batch, 0, frame))
            self._record(batch, frame)

    def _attempt(self, call: Callable[[Value], Frame], value: Value) -> Frame | None:
        """Call the simulation and return its next frame; None if it fails, which `describe_task` reports."""
        try:
            frame = call(value)
        except RunError as error:
            self._newest = None
            self._failure = self.diagnostics.stuck = str(error)
            return None
        self._failure = self.diagnostics.stuck = ""
        return frame

    def _repeat(self) -> None:
        """Repeat the last message, which may have been lost."""
        if self._result is not None:
            self._episodes.publish(self._result)
        elif self._newest is not None:
            self._observations.publish(self._newest)

    def _act(self, message: Action) -> None:
        batch, observation = self._batch, self._newest
        if batch is None or observation is None or not self._expects(message):
            expected = f"batch {self._identity}, step {self._step}, policy version {self._version}"
            got = f"batch {message.batch}, step {message.step}, policy version {message.policy_version}"
            self.diagnostics.skip(f"action: expected {expected}, got {got}")
            return
        try:
            actions = matrix(message.actions, batch.num_envs, self._simulation.spaces.action_dim, "actions")
        except ValueError as error:
            self.diagnostics.refuse(f"action: {error}")
            return
        frame = self._attempt(self._simulation.step, actions)
        if frame is None:
            return
        self._step += 1
        self._clock_steps += 1
        show(observation, self._step, frame)
        self._publish(observation)
        self._record(batch, frame, actions)
        self.diagnostics.steps += 1
        self._tick()
        if self._robot is not None:
            self._robot.publish()

    def _expects(self, message: Action) -> bool:
        expected = (self._identity, self._step, self._version)
        return (message.batch, message.step, message.policy_version) == expected and self._is_waiting

    @property
    def _is_waiting(self) -> bool:
        """Whether the node waits for an action."""
        return self._newest is not None and not self._newest.over

    def _publish(self, message: Observation) -> None:
        self._newest = message
        self._observations.publish(message)
        self._retry_s = FIRST_RETRY_S
        self._retry_at = time.monotonic() + FIRST_RETRY_S

    def _record(self, batch: Batch, frame: Frame, actions: Array | None = None) -> None:
        """Record a step after publishing it, while the policy node computes.

        Batches with seeds of their own are not recorded; their client has all observations.
        """
        if self._recorder is None:
            return
        if actions is not None:
            self._recorder.acted(self._step - 1, actions)
        self._recorder.observed(self._step, frame)
        if frame.is_over:
            self._result = episodes_message(msg, self._identity, self._version, self._recorder.episodes())
            self._episodes.publish(self._result)

    def _tick(self) -> None:
        seconds = self._clock_steps * self._simulation.step_seconds
        if self._clock_has_subscribers and seconds < CLOCK_ENDS:
            self._clock_ticks.publish(clock_message(seconds))


def main() -> None:
    """Run the simulator node."""
    with one_thread():
        run(SimulatorNode, "simulator", serve)


if __name__ == "__main__":
    main()
