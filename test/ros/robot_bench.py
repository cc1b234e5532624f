"""All peers of a robot node in one test node: sensor, gate, policy and learner, each of which may fail."""

import json
import time
from array import array
from pathlib import Path
from typing import Any

from std_msgs.msg import Empty, Float64
from std_srvs.srv import SetBool, Trigger

from rkhs_interfaces.msg import Action, Command, GateReport, GateState, Observation
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.nodes.core.diagnostics import UNCONNECTED
from rkhs_ros.nodes.core.messages import LATCHED_QOS, LOCKSTEP_QOS
from test.ros.conftest import ROOT, Probe

CONFIG = ROOT / "config" / "robot_pendulum.yaml"
# Ten times as fast as the wall, so that what is late on a busy machine must be let pass.
QUICK = (
    "simulated_robot.speed=10.0",
    "robot.period=0.01",
    "robot.action_deadline=1.0",
    "robot.misses_allowed=40",
    "robot.stale_after=1.0",
    "robot.learner_timeout=2.0",
    "robot.reset.home.speed=[30.0]",
    "gate.command_timeout=2.0",
    "gate.stale_after=1.0",
    "model={form: none}",
    "algorithm={name: rkhs_nac}",
    "horizon=40",
    "episodes_per_iteration=2",
)
PERIOD, HORIZON = 0.04, 5
SENSOR_PERIOD_S, LIFE_PERIOD_S = 0.01, 0.05
SECTION: dict[str, Any] = {
    "task": "slider",
    "period": PERIOD,
    "misses_allowed": 1,
    "action_deadline": 0.9,
    "stale_after": 0.3,
    "learner_timeout": 0.5,
    "sensors": {"position": {"topic": "position", "type": "std_msgs/msg/Float64", "fields": ["data"]}},
    "action": {"minimum": [-1.0], "maximum": [1.0], "scale": [2.0]},
    "reward": {"function": "test.unit.robot.robot_rules:encoded"},
}


def write_section(path: Path, **changes: object) -> Path:
    path.write_text(json.dumps({"/**/robot": {"ros__parameters": SECTION | changes}}))
    return path


class Bench:
    """What a robot node talks to; each part does its work unless told to be silent."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.silent: set[str] = set()  # of sensor, gate, policy and learner
        self.position = 0.0
        self.commands: list[tuple[float, Command]] = []  # with when they came
        self.executed = 0.5  # share of a command that the gate passes on
        self._identity = 0
        node = probe
        self._state = node.create_publisher(GateState, "gate/state", LATCHED_QOS)
        self._reports = node.create_publisher(GateReport, "gate/report", LOCKSTEP_QOS)
        self.sensor = node.create_publisher(Float64, "position", 1)
        self._life = node.create_publisher(Empty, "learner_alive", LOCKSTEP_QOS)
        self._actions = node.create_publisher(Action, "action", LOCKSTEP_QOS)
        node.create_subscription(Command, "command", self._command, LOCKSTEP_QOS)
        node.create_subscription(Observation, "observation", self._answer, LOCKSTEP_QOS)
        node.create_timer(SENSOR_PERIOD_S, self._sense)
        node.create_timer(LIFE_PERIOD_S, self._live)
        for name in ("start", "veto"):
            node.add_service(f"robot/{name}", Trigger)
        node.add_service("robot/pause", SetBool)
        self.gate_state("holding")

    def gate_state(self, state: str, reason: str = "") -> None:
        self._state.publish(GateState(state=state, reason=reason))

    def meet(self) -> None:
        """Wait until the robot node hears all that is said here, and is heard."""
        told = (self._reports, self.sensor, self._life, self._actions, self._state)
        self.probe.until(lambda: all(each.get_subscription_count() for each in told))

    def describe(self) -> DescribeTask.Response:
        return self.probe.ask("describe_task", DescribeTask.Request())

    def start(self, episode: int = 0, **changes: object) -> int:
        """Ask for an episode under a number of its own, which is returned."""
        self._identity += 1
        numbers = {"batch": self._identity, "policy_version": 1, "seed": 3, "num_envs": 1, "horizon": HORIZON}
        request = {"environment": "slider", "options": "{}", "explore": True, "first_episode": episode, **numbers}
        asked = StartEpisodes.Request(**{**request, **changes})
        self.probe.until(lambda: self._is_answered(asked))
        return self._identity

    def _is_answered(self, request: StartEpisodes.Request) -> bool:
        """Ask for an episode; return whether the nodes have met each other, and assert that they then accept."""
        response = self.probe.ask("start_episodes", request)
        assert response.success or response.message.startswith(UNCONNECTED), response.message
        return bool(response.success)

    def failed(self) -> str:
        self.probe.until(lambda: any(each.failure for each in self.probe.heard["episodes"]))
        return str(self.probe.heard["episodes"][-1].failure)

    def ended(self, identity: int, count: int = 1) -> Any:
        """Return the message of this count with the episode asked for under a number."""

        def heard() -> list[Any]:
            return [message for message in self.probe.heard["episodes"] if message.batch == identity]

        self.probe.until(lambda: len(heard()) >= count)
        return heard()[count - 1]

    def play(self, episode: int = 0, **changes: object) -> Any:
        return self.ended(self.start(episode, **changes))

    def say(self, service: str) -> Trigger.Response:
        return self.probe.ask_once(f"robot/{service}", Trigger.Request(), "robot")

    def until_moving(self, step: int = 1) -> None:
        self.probe.until(lambda: any(message.step >= step for message in self.observations()))

    def observations(self) -> list[Observation]:
        return [m for m in self.probe.heard["observation"] if m.batch == self._identity]

    @property
    def moves(self) -> list[float]:
        return [command.values[0] for _, command in self.commands if not command.hold]

    @property
    def is_at_rest(self) -> bool:
        return bool(self.commands) and self.commands[-1][1].hold

    def _command(self, message: Command) -> None:
        self.commands.append((time.monotonic(), message))
        if "gate" not in self.silent:
            executed = array("d", [self.executed * value for value in message.values])
            report = {"instance": message.instance, "number": message.number}
            self._reports.publish(GateReport(asked=message.values, executed=executed, **report))

    def _answer(self, message: Observation) -> None:
        if "policy" not in self.silent and not message.over:
            place = {"batch": message.batch, "step": message.step, "policy_version": message.policy_version}
            self._actions.publish(Action(actions=array("d", [drawn(message.step)]), **place))

    def _sense(self) -> None:
        if "sensor" not in self.silent:
            self.sensor.publish(Float64(data=self.position))

    def _live(self) -> None:
        if "learner" not in self.silent:
            self._life.publish(Empty())


def drawn(step: int) -> float:
    """Return the action of a step; the last one is beyond its bound."""
    return 0.3 * (step + 1)
