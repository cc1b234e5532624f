"""The robot node's control of a robot during resets and episodes. It holds still if the learner sends no heartbeat."""

import time
from collections.abc import Callable, Iterator

import numpy as np
from rclpy.time import Time
from std_srvs.srv import Trigger

from rkhs_interfaces.msg import Action, Observation
from rkhs_ros.base.endings import RunError, SilentError
from rkhs_ros.base.validation import require, truncated
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS
from rkhs_ros.nodes.core.spin import ReportingNode
from rkhs_ros.nodes.robot.gate_link import GateLink
from rkhs_ros.nodes.robot.sensor_topics import SensorTopics
from rkhs_ros.policies.messages import doubles, shaped
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.episode import Reading, RobotEpisode, next_tick
from rkhs_ros.robot.reset import Joints, Means, ResetError, reset_steps
from rkhs_ros.robot.sensors import SensingError, fresh
from rkhs_ros.robot.task import RobotTask

RESET_PERIOD_S = 0.05  # between the commands of a reset, at most
IDLE_S = 1.0  # until the next check without an episode
PATIENCE_S = 5.0  # for the gate of a simulated robot to arm itself; later, an operator has to arm it
PEERS_TIMEOUT_S = 5.0  # for sensors and the service to become available before a reset; after it the run ends


class EpisodeDriver:
    """Runs one episode at a time on the robot, including the reset before it.

    Owns the current episode, its reset and the last command.
    """

    def __init__(
        self, node: ReportingNode, task: RobotTask, *, simulated: bool, ended: Callable[[RobotEpisode], None]
    ) -> None:
        self.episode: RobotEpisode | None = None  # also during the reset before it
        self.lockstep = (0, 0)  # batch and policy version of the episode's messages
        self.alive_at = 0.0  # monotonic time of the last heartbeat of the learner, seconds
        self.paused = False  # whether the operator wants no further episode to start
        self.waiting = ""  # what the operator has to do; empty if nothing
        self._node = node
        self._task = task
        self._ended = ended
        self._reset: Iterator[Array | str] | None = None
        self._confirmations = 0  # of the operator
        self._reset_period = min(task.period, RESET_PERIOD_S)
        self._due = 0.0  # monotonic time of the next command of a reset, seconds
        # Monotonic times, seconds: of the request or the last obstacle, of the first observation, and of no obstacle.
        self._began_at = self._ready_at = self._clear_at = 0.0
        self._timeout = 0.0  # seconds without a first action; 0 for no limit
        self._moved = 0  # number of the last motion of a reset
        self._sent: dict[int, int] = {}  # steps of the episode's commands, by number
        self._fault = ""  # why the policy cannot act
        self._is_shown = False  # whether the policy has an observation of the episode
        self._gate = GateLink(node, task.stale_after, self._hear_report, simulated=simulated)
        self.sensors = SensorTopics(node, task)
        self._observations = node.create_publisher(Observation, "observation", LOCKSTEP_QOS)
        self._service = node.create_client(Trigger, task.reset.trigger.service or "~/trigger")
        self._means = Means(
            task.action.kind,
            time.monotonic,
            self._sense_joints,
            call=lambda: self._service.call_async(Trigger.Request()),
            question=f"prepare the scene, then run: {self.call('start')}",
            confirmations=lambda: self._confirmations,
        )
        node.create_subscription(Action, "action", self._act, LOCKSTEP_QOS)

    def begin(self, batch: Batch, identity: int, version: int, timeout: float) -> None:
        """Start an episode with the policy of that version, which has ``timeout`` seconds for its first action."""
        self.episode = RobotEpisode(batch, self._task, time.time_ns())
        self.lockstep, self._timeout, self._sent = (identity, version), timeout, {}
        self._began_at = self._clear_at = self._due = time.monotonic()

    def confirm(self) -> None:
        """Continue on the operator's confirmation."""
        self._confirmations += not self.paused
        self.paused = False

    def discard(self, reason: str) -> None:
        """Discard the current episode, if there is one."""
        if self.episode is not None:
            self.episode.discard(reason)
            self._finish(self.episode)

    def close(self) -> None:
        """Command the robot to hold before the node exits."""
        self.discard("the robot node is shutting down")
        self._gate.close()

    def proceed(self, now: float) -> float:
        """Process due events; return the monotonic time of the next one. Raise RunError if the run must end."""
        episode = self.episode
        if episode is None:
            return now + IDLE_S
        if self._fault:
            raise RunError(self._fault)
        if not self._is_shown:
            return self._prepare(episode, now)
        if fault := self._gate.obstacle() or self._silence(now):
            episode.discard(fault)
        if not episode.moving and not episode.over:
            if 0 < self._timeout < now - self._ready_at:
                raise SilentError(f"the policy node did not act within {self._timeout:g} s")
            return now + self._task.learner_timeout
        if episode.proceed(now, self._sense):
            if episode.complete:
                self._gate.hold()
            self._show(episode)
        if episode.over:
            self._finish(episode)
        return min(episode.due, now + min(self._task.learner_timeout, self._task.stale_after))

    def _silence(self, now: float) -> str:
        silent, most = now - self.alive_at, self._task.learner_timeout
        return f"no heartbeat of the learner for {silent:.2g} s (learner_timeout {most:g})" * (silent > most)

    # Before the first step.

    def _prepare(self, episode: RobotEpisode, now: float) -> float:
        """Do the next part of the reset if it is due; return the monotonic time of the next one."""
        if now < self._due:
            return self._due
        self._due = next_tick(self._due, self._reset_period, now)
        obstacle = self._gate.obstacle()
        if self._reset is not None and (fault := obstacle or self._silence(now)):
            self.discard(fault)
        elif self._reset is not None:
            self._continue_reset(self._reset, episode)
        elif obstacle or self.paused:
            self.waiting, self._began_at = self._remedy(obstacle, now), now
        elif self._is_ready(now):
            self.waiting = ""
            self._reset = reset_steps(self._task.reset, self._means)
        return self._due

    def _remedy(self, obstacle: str, now: float) -> str:
        """Return what the operator has to do about an obstacle or a pause; empty if a simulated robot ends it."""
        self._clear_at = self._clear_at if obstacle else now
        if self._gate.removes_obstacles(now) and not self.paused and now < self._clear_at + PATIENCE_S:
            return ""
        what = f"{obstacle}; {self._gate.remedy}" if obstacle else self._pause
        return self.sensors.obstacle() or what

    @property
    def _pause(self) -> str:
        """What the operator has to do during a pause; empty without one."""
        return f"paused; to continue: {self.call('start')}" if self.paused else ""

    def call(self, service: str) -> str:
        """Return the commands with which the operator calls a service of the node."""
        name = f"{self._node.get_fully_qualified_name()}/{service}"
        return f"rkhs robot {service} FOLDER, or ros2 service call {name} std_srvs/srv/Trigger"

    def _is_ready(self, now: float) -> bool:
        """Return whether all sensors and the service of the reset are usable; raise RunError if not in time."""
        missing, trigger = self.sensors.obstacle(), self._task.reset.trigger.service
        try:
            self._observe()
        except SensingError as error:
            missing = missing or str(error)
        if not missing and "trigger" in self._task.reset.steps and not self._service.service_is_ready():
            missing = f"reset.trigger: expected a service {self._node.resolve_service_name(trigger)}, got none"
        if missing and now - self._began_at > PEERS_TIMEOUT_S:
            raise RunError(f"{missing}, for {PEERS_TIMEOUT_S:g} s")
        return not missing

    def _continue_reset(self, reset: Iterator[Array | str], episode: RobotEpisode) -> None:
        try:
            outcome = next(reset, None)
            if isinstance(outcome, np.ndarray):
                self._moved = self._gate.send(outcome, time.time_ns())
                return
            if self._moved == self._gate.number:  # the last command was a motion of the reset
                self._gate.hold()
            self.waiting = outcome or self._pause
            if outcome is None and not self.paused:
                episode.begin(self._observe())
                self._show(episode)
                self._ready_at = time.monotonic()
        except (ResetError, SensingError) as error:
            self.discard(str(error))

    # Steps.

    def _show(self, episode: RobotEpisode) -> None:
        self._is_shown = True
        identity, version = self.lockstep
        over, terminated = episode.complete, episode.complete and episode.terminated
        self._observations.publish(
            Observation(
                stamp=Time(nanoseconds=episode.stamps[-1]).to_msg(),
                batch=identity,
                policy_version=version,
                step=episode.step,
                over=over,
                **vars(episode.batch),
                observations=doubles(episode.observations[-1]),
                rewards=episode.rewards[-1:],
                terminated=[0] if terminated else [],
                truncated=[0] if over and not terminated else [],
            )
        )

    def _act(self, message: Action) -> None:
        episode = self.episode
        if episode is None or (message.batch, message.policy_version) != self.lockstep:
            self._node.diagnostics.skip(f"action: batch {message.batch} is not running")
            return
        if message.failure:
            self._fault = truncated(message.failure)
            return
        try:
            action = shaped(message.actions, (self._task.action.dimension,), "actions")
            require(message.step < episode.batch.horizon, "step", f"less than {episode.batch.horizon}", message.step)
        except ValueError as error:
            self._node.diagnostics.refuse(f"action: {error}")
            return
        # Before the motion, the observation is still valid.
        stamp = episode.stamps[-1] if episode.moving else time.time_ns()
        command = episode.act(message.step, action, time.monotonic())
        if command is not None:
            self._sent[self._gate.send(command, stamp)] = message.step

    def _hear_report(self, number: int, executed: Array, flags: int) -> None:
        if self.episode is not None and number in self._sent:
            self.episode.report(self._sent[number], executed, flags)

    def _observe(self) -> Reading:
        """Return a reading of the sensors without a reward; raise SensingError if one is silent or stale."""
        return Reading(self._task.sensors.observation(self.sensors.heard(), time.monotonic()), 0.0, time.time_ns())

    def _sense(self) -> Reading:
        """Return a reading of the sensors and of the reward topic."""
        reading, reward = self._observe(), self._task.reward
        if not reward.topic:  # reading all messages again takes time
            return reading
        value = reward.heard(self.sensors.heard(), time.monotonic(), self._task.stale_after)
        return reading._replace(reward=value)

    def _sense_joints(self) -> Joints:
        home = self._task.reset.home
        return home.joints_in(fresh(self.sensors.heard(), home.topic, time.monotonic(), self._task.stale_after))

    def _finish(self, episode: RobotEpisode) -> None:
        """Command the robot to hold, and report the end of the episode."""
        self._gate.hold()
        self.episode = self._reset = None
        self._is_shown, self.waiting, self._fault = False, "", ""
        self._ended(episode)
