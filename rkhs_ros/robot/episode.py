"""One episode on a robot, timed by the wall clock."""

from collections.abc import Callable
from math import inf
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_state import Flags
from rkhs_ros.robot.sensors import SensingError
from rkhs_ros.robot.task import RobotTask

MISSED, LATE, NO_REPORT = 256, 512, 1024  # flags of a step, besides those of the gate, as in rkhs_interfaces/GateReport
LAST_ACTIONS_TIMEOUT_S = 0.5  # wait after the last step for late actions
SLACK = 0.1  # fraction of the period by which a tick may be late without shifting the ticks after it


def next_tick(due: float, period: float, now: float) -> float:
    """Return the monotonic time of the tick after the one that was due and happens now, seconds.

    A slightly late tick does not shift later ticks, which preserves the mean period. A very late tick shifts all later
    ticks: otherwise the next step would be too short, and its action would act for less time than the policy expects.
    """
    return (now if is_late(due, period, now) else due) + period


def is_late(due: float, period: float, now: float) -> bool:
    """Return whether a tick now is so late that it shifts those after it."""
    return now - due > SLACK * period


class Reading(NamedTuple):
    """One reading: the observation, shape (d,), the reward topic's value or 0, and the nanoseconds since 1970."""

    observation: Array
    reward: float
    stamp: int


class RobotEpisode:
    """One running episode, driven by time, sensor readings and incoming actions.

    The episode waits at rest for the first action, which starts its clock. Each tick yields the reward of the last step
    and the next observation. An action that arrives before the deadline becomes a command; otherwise the miss is
    counted and no command is sent. Late actions are recorded, because the policy drew them, but not executed. Any fault
    discards the episode.

    Owns the observations, drawn actions, executed actions and rewards. Owns no clock and sends nothing.

    Args:
        batch: the episode's batch, of one environment.
        task: the robot's task.
        stamp: start of the episode, nanoseconds since 1970.

    Attributes:
        step: number of finished steps.
        discard_reason: why the episode is discarded; empty if it is not.
        misses: number of actions that missed their deadline.
        terminated: whether the task terminated the episode.
        observations: each of shape (d,).
        stamps: times of the observations, nanoseconds since 1970.
        rewards: of the finished steps.
    """

    def __init__(self, batch: Batch, task: RobotTask, stamp: int) -> None:
        horizon, actions = batch.horizon, task.action.dimension
        self.batch = batch
        self.step = 0
        self.discard_reason = ""
        self.misses = 0
        self.terminated = False
        self.observations: list[Array] = []
        self.stamps = [stamp]
        self.rewards: list[float] = []
        self._task = task
        self._drawn: list[Array | None] = [None] * horizon
        self._sent: list[Array | None] = [None] * horizon
        self._reported: list[Array | None] = [None] * horizon
        self._executed = np.zeros((horizon, actions))
        self._flags = np.zeros(horizon, dtype=np.uint32)
        self._due: float | None = None  # monotonic time of the next tick, seconds; None before the first action
        self._ticked_at = 0.0

    @property
    def over(self) -> bool:
        """Whether the episode has ended, completed or discarded."""
        return bool(self.discard_reason) or (self.complete and self._missing is None)

    @property
    def complete(self) -> bool:
        """Whether no further step follows; late actions may still arrive and are recorded."""
        return self.terminated or self.step == self.batch.horizon

    @property
    def _missing(self) -> int | None:
        """The first finished step whose action has not arrived yet; None if there is none."""
        return next((step for step in range(self.step) if self._drawn[step] is None), None)

    @property
    def moving(self) -> bool:
        """Whether the first action has arrived and the episode has not ended."""
        return self._due is not None and not self.over

    @property
    def due(self) -> float:
        """Monotonic time of the next event, a tick or an action's deadline; infinity before the first action."""
        if self._due is None or self.over:
            return inf
        if self.complete:
            return self._ticked_at + LAST_ACTIONS_TIMEOUT_S
        return self._due if self._answered else min(self._deadline, self._due)

    def begin(self, sensed: Reading) -> None:
        """Store the first observation."""
        self.observations.append(sensed.observation)
        self.stamps[0] = sensed.stamp

    def act(self, step: int, action: Array, now: float) -> Array | None:
        """Store the action of a step; return the command to send, or None if the action is late or repeated."""
        if self.over or not self.observations or step > self.step or self._drawn[step] is not None:
            return None
        self._drawn[step] = action
        if self._due is None:
            self._due, self._ticked_at = now + self._task.period, now
        elif step < self.step or now > self._deadline or self._flags[step] & MISSED:
            return None
        self._sent[step] = self._task.action.command(action)
        return self._sent[step]

    def report(self, step: int, executed: Array, flags: int) -> None:
        """Store the gate's report of the command of a step, unless the step is over; a refusal always counts."""
        if self.over or step > self.step or self._sent[step] is None:
            return
        if step == self.step:
            self._reported[step] = executed
            self._flags[step] |= flags
        if flags & (Flags.REFUSED | Flags.NOT_ARMED):
            self.discard(f"the gate refused the command of step {step}")

    def discard(self, reason: str) -> None:
        """Discard the episode, unless it has ended."""
        if not self.over:
            self.discard_reason = reason

    def proceed(self, now: float, sense: Callable[[], Reading]) -> bool:
        """Process events that are due at a monotonic time, seconds; return whether there is a new observation.

        ``sense`` reads the sensors; it may raise SensingError. A failing function of the task raises RunError.
        """
        if self._due is None or self.over:
            return False
        if self.complete:
            if now >= self.due:
                self.discard(f"the action of step {self._missing} did not arrive")
            return False
        if not self._answered and (now > self._deadline or now >= self._due):
            self._miss()
        if self.over or now < self._due:
            return False
        try:
            sensed = sense()
        except SensingError as error:
            self.discard(str(error))
            return False
        self._tick(now, sensed, self._due)
        return True

    @property
    def _answered(self) -> bool:
        """Whether the current step has its command, or its action was counted as missed."""
        return self._sent[self.step] is not None or bool(self._flags[self.step] & MISSED)

    @property
    def _deadline(self) -> float:
        return self._ticked_at + self._task.action_deadline * self._task.period

    def _miss(self) -> None:
        self._flags[self.step] |= MISSED
        self.misses += 1
        if self.misses > self._task.misses_allowed:
            self.discard(f"{self.misses} actions arrived too late, the last one in step {self.step}")

    def _tick(self, now: float, sensed: Reading, due: float) -> None:
        step, period = self.step, self._task.period
        self._settle(step)
        self._flags[step] |= LATE * is_late(due, period, now)
        self._due, self._ticked_at = next_tick(due, period, now), now
        action = self._task.action.action(self._executed[step])
        transition = (self.observations[-1], action, sensed.observation)
        reward = self._task.reward.of(sensed.reward, *transition)
        self.terminated = self._task.end.is_reached(*transition)
        self.rewards.append(reward)  # last, so that a failing rule leaves no partial step
        self.observations.append(sensed.observation)
        self.stamps.append(sensed.stamp)
        self.step += 1

    def _settle(self, step: int) -> None:
        """Record the executed command of a finished step: reported by the gate, else sent, else held."""
        sent, reported = self._sent[step], self._reported[step]
        if sent is not None and reported is None:
            self._flags[step] |= NO_REPORT
        executed = reported if reported is not None else sent
        self._executed[step] = self._executed[step - 1] if executed is None else executed

    def ended(self) -> tuple[Episodes, Execution]:
        """Return the steps so far and how they were executed; in a discarded episode, missing actions are 0."""
        steps, horizon = len(self.rewards), self.batch.horizon
        observations = np.zeros((1, horizon, self._task.sensors.dimension))
        actions = np.zeros((1, horizon, self._task.action.dimension))
        rewards = np.zeros((1, horizon))
        rewards[0, :steps] = self.rewards
        for step in range(steps):
            observations[0, step] = self.observations[step]
            drawn = self._drawn[step]
            actions[0, step] = 0.0 if drawn is None else drawn
        final = self.observations[-1] if self.observations else np.zeros(self._task.sensors.dimension)
        terminated = np.array([self.terminated and not self.discard_reason])
        mask = np.arange(horizon)[None] < steps
        stamps = np.array(self.stamps, dtype=np.int64)
        return (
            Episodes(observations, actions, rewards, mask, final[None], terminated),
            Execution(stamps, self._executed[:steps], self._flags[:steps], self.discard_reason),
        )
