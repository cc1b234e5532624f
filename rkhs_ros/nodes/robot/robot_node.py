"""The robot node: runs episodes on a robot over its own topics, with steps timed by the wall clock."""

import time
from dataclasses import replace
from typing import NamedTuple

from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from rkhs_interfaces import msg
from rkhs_interfaces.msg import Episodes
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.base.endings import RunError, SilentError
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes as EpisodeValues, Execution
from rkhs_ros.nodes.core.diagnostics import Diagnostics, unconnected
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, batch_of
from rkhs_ros.nodes.core.parameters import declare, declared, given
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from rkhs_ros.nodes.robot.robot_driver import EpisodeDriver
from rkhs_ros.policies.messages import spaces_fields
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.messages import episodes_message
from rkhs_ros.robot.episode import RobotEpisode
from rkhs_ros.robot.task import robot_task_from

CALM_S = 0.005  # before the next due event, during which the node does nothing else


class Finished(NamedTuple):
    """An episode that has ended, with the numbers of its batch and its policy."""

    batch: int
    version: int
    episodes: EpisodeValues
    execution: Execution


class RobotNode(ReportingNode):
    """Runs episodes on a robot, one at a time, with the same interface to the learner as a simulator.

    Owns the episode that may still be vetoed. The learner assigns the episodes' numbers, and records them. Commands go
    to the gate, never directly to the hardware.
    """

    def open(self) -> None:
        """Read the task, and open topics and services."""
        tree = given(self, needs_section=True)
        about = "end protective stops automatically, for simulated robots whose gate arms itself only"
        simulated = declared(self, tree, "simulated", False, about)
        self._task = robot_task_from(tree)
        declare(self, self._task.entries())
        self._request = StartEpisodes.Request()  # the newest one
        self._held: Finished | None = None  # a completed episode that may still be vetoed
        self._held_until = 0.0  # monotonic time, seconds
        self._reported: Finished | None = None  # the last completed one that was published
        self._failure = ""
        self._misses = self._discarded = 0
        self.diagnostics = Diagnostics(self, self._report)
        self._motion = EpisodeDriver(self, self._task, simulated=simulated, ended=self._ended)
        self.resources.callback(self._motion.close)
        self._open_topics()
        self.get_logger().info(f"ready for episodes of {self._task.task}")

    def _open_topics(self) -> None:
        self._episodes = self.create_publisher(Episodes, "episodes", LOCKSTEP_QOS)
        self.create_subscription(Empty, "learner_alive", self._hear_learner, LOCKSTEP_QOS)
        self.create_service(StartEpisodes, "start_episodes", self._start)
        self.create_service(DescribeTask, "describe_task", self._describe)
        self.create_service(Trigger, "~/start", self._go_on)
        self.create_service(Trigger, "~/veto", self._veto)
        self.create_service(SetBool, "~/pause", self._pause)

    def heartbeat(self) -> float:
        """Process due events; return the seconds until the next one."""
        now = time.monotonic()
        if now >= self._held_until:
            self._release()
        due = self._proceed(now) if self._held is None else self._held_until
        if due - now < CALM_S:
            return max(due - time.monotonic(), 0.0)
        self._motion.sensors.heartbeat(now)
        self.diagnostics.waiting = self._motion.waiting
        return max(min(self.diagnostics.heartbeat(), due - time.monotonic()), 0.0)

    def _proceed(self, now: float) -> float:
        """Continue the episode; if that fails, discard it and report the reason to the learner."""
        try:
            return self._motion.proceed(now)
        except SilentError:
            raise  # ends the run, which can be resumed
        except RunError as error:
            self._failure = self.diagnostics.stuck = f"{self._task.task}: {error}"
            self._motion.discard(str(error))
            return now

    # Requests of the learner.

    def _describe(self, request: DescribeTask.Request, response: DescribeTask.Response) -> DescribeTask.Response:
        return DescribeTask.Response(
            environment=self._task.task,
            options="{}",
            **spaces_fields(self._task.spaces),
            capacity=1,
            num_envs=1,
            period=self._task.period,
            learner_timeout=self._task.learner_timeout,
            waiting=self._motion.waiting,
        )

    def _start(self, request: StartEpisodes.Request, response: StartEpisodes.Response) -> StartEpisodes.Response:
        if message := unconnected(self, "observation", "action"):
            response.message = message
            return response
        self._motion.alive_at = time.monotonic()
        with self.diagnostics.accepting(response, "start_episodes"):
            batch = batch_of(request)
            requested = (request.environment, request.options)
            require(requested == (self._task.task, "{}"), "task", self._task.task, " with options ".join(requested))
            require(batch.num_envs == 1, "num_envs", "1 for a robot", batch.num_envs)
            self._take(request, batch)
        return response

    def _take(self, request: StartEpisodes.Request, batch: Batch) -> None:
        """Start an episode in place of the current one."""
        self._release()
        self._motion.discard("another episode was requested")
        self._request, self._failure, self.diagnostics.stuck = request, "", ""
        self._motion.begin(batch, request.batch, request.policy_version, request.timeout)

    def _hear_learner(self, message: Empty) -> None:
        self._motion.alive_at = time.monotonic()

    # The end of an episode.

    def _ended(self, episode: RobotEpisode) -> None:
        """Publish an ended episode; one that may be vetoed is published again when this is decided."""
        episodes, execution = episode.ended()
        self._misses += episode.misses
        self.diagnostics.steps += len(execution.flags)
        if reason := execution.discard_reason:
            self._discarded += 1
            self.get_logger().warning(f"episode {episode.batch.first_episode + 1} is discarded: {reason}")
        finished = Finished(self._request.batch, self._request.policy_version, episodes, execution)
        if self._failure:  # the learner exits; it must not repeat the episode
            place = {"batch": finished.batch, "policy_version": finished.version}
            self._episodes.publish(Episodes(failure=self._failure, **place))
        elif reason or not self._task.veto_window:
            self._publish(finished)
        else:
            self._held, self._held_until = finished, time.monotonic() + self._task.veto_window
            self._publish(finished, vetoable=True)

    def _release(self) -> None:
        """Publish an episode that may no longer be vetoed."""
        if self._held is not None:
            held, self._held = self._held, None
            self._publish(held)

    def _publish(self, finished: Finished, *, vetoable: bool = False) -> None:
        message = episodes_message(msg, finished.batch, finished.version, finished.episodes, [finished.execution])
        message.vetoable = vetoable
        self._episodes.publish(message)
        if not vetoable and not finished.execution.discard_reason:
            self._reported = finished

    # Requests of the operator.

    def _go_on(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._motion.confirm()
        response.success = True
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._motion.paused, response.success = request.data, True
        response.message = f"before the next episode; to continue: {self._motion.call('start')}" if request.data else ""
        return response

    def _veto(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Discard the last completed episode, unless the learner may already have used it.

        The learner cannot have used an episode that is held back, nor one whose policy is still acting.
        """
        if self._held is not None:
            vetoed, self._held = self._held, None
        elif self._reported and self._motion.episode and self._reported.version == self._request.policy_version:
            vetoed, self._reported = self._reported, None
        else:
            response.message = "the learner has already used all completed episodes (veto_window holds them back)"
            return response
        execution = replace(vetoed.execution, discard_reason="vetoed by the operator")
        self._publish(vetoed._replace(execution=execution))
        self._discarded += 1
        response.success = True
        return response

    def _report(self) -> dict[str, object]:
        batch, version = self._motion.lockstep
        episode = self._motion.episode
        return {
            "serving version": version,
            "batch": batch,
            "step": episode.step if episode else 0,
            "state": "idle" if episode is None else "moving" if episode.moving else "getting ready",
            "misses": self._misses,
            "discarded episodes": self._discarded,
            **self._motion.sensors.report(),
        }


def main() -> None:
    """Run the robot node."""
    run(RobotNode, "robot", serve)


if __name__ == "__main__":
    main()
