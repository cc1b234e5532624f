"""The node whose parameters are tuned: it is checked, gets values, runs trials, and gets its earlier values again."""

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import parameter_value_to_python
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from rkhs_ros.base.endings import RunError, deferred_signals
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS
from rkhs_ros.nodes.core.peers import ClientNode
from rkhs_ros.nodes.robot.sensor_topics import SENSOR_QOS, types_of
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.sensors import ReceivedMessage, SensingError
from rkhs_ros.robot.tuning import Tuning

Values = dict[str, Any]
ATTEMPTS = 3  # at a trial in which a sensor falls silent
BEFORE = "parameters_before.yaml"  # in the run's folder while they may be changed
NUMBERS = {ParameterType.PARAMETER_DOUBLE: float, ParameterType.PARAMETER_INTEGER: round}


class TuningNode(ClientNode):
    """The node that sets parameters and records sensors.

    Owns the newest message of each topic.

    Raises:
        ValueError: a type is unknown or has no such field, or a topic has two types.
    """

    def __init__(self, tuning: Tuning) -> None:
        self.heard: dict[str, ReceivedMessage] = {}
        topics = [(sensor.topic, sensor.type, sensor.fields) for _, sensor in tuning.sensors]
        if tuning.reward.topic:
            topics.append((tuning.reward.topic, tuning.reward.type, (tuning.reward.field,)))
        types = types_of(topics)  # before there is a node to close
        super().__init__("tuning", tuning.timeout)
        for topic, kind in types.items():
            self.create_subscription(kind, topic, partial(self._hear, topic), SENSOR_QOS)

    def _hear(self, topic: str, message: Any) -> None:
        self.heard[topic] = ReceivedMessage(message, time.monotonic())


class TunedNode:
    """The connection to a node whose parameters are tuned.

    Owns our node, and the values that the parameters had before: they are set again when the connection closes, and are
    in a file until then, from which the next connection of the folder sets them.

    Args:
        tuning: the tuning.
        folder: folder of that file.

    Raises:
        SilentError: a node does not answer in time.
        ValueError: the node has no such parameter, it is read-only or no number, or its range is narrower.
    """

    def __init__(self, tuning: Tuning, folder: Path) -> None:
        self._tuning, self._file = tuning, folder / BEFORE
        self._node = TuningNode(tuning)
        self._peers = self._node.peers
        try:
            self.name = tuning.node if tuning.node.startswith("/") else f"/{tuning.node}"
            kinds = {"describe": DescribeParameters, "get": GetParameters, "set": SetParametersAtomically}
            ends = {"describe": "describe_parameters", "get": "get_parameters", "set": "set_parameters_atomically"}
            self._clients = {
                key: self._node.create_client(kind, f"{self.name}/{ends[key]}") for key, kind in kinds.items()
            }
            for client in self._clients.values():
                self._peers.wait_for_service(client, self.name)
            trial = tuning.trial
            self._start = self._node.create_client(Trigger, trial.service) if trial.service else None
            self._starts = self._node.create_publisher(Empty, trial.topic, LOCKSTEP_QOS) if trial.topic else None
            self._kinds = self._checked()
            self.before = self._remembered()
        except BaseException:
            self._node.close()
            raise

    def values(self, places: Array) -> Values:
        """Return the values at the places in their ranges, of the types of the parameters."""
        return {name: self._kinds[name](value) for name, value in self._tuning.values(places).items()}

    def context(self) -> Array:
        """Return the context, shape (c,), once all sensors are heard.

        Raises:
            RunError: a sensor is silent, or its message is unusable.
        """
        topics = [sensor.topic for _, sensor in self._tuning.sensors]
        self._node.heard.clear()  # what was heard before the next trial was chosen is old
        self._peers.spin(lambda: all(each in self._node.heard for each in topics), self._tuning.timeout)
        try:
            return self._sensed()[self._tuning.context_columns()]
        except SensingError as error:
            raise RunError(str(error)) from error

    def trial(self, values: Values) -> tuple[float, str]:
        """Run a trial; return its reward, and why the node rejects the values, or an empty text.

        Raises:
            RunError: a node is silent, the trial does not start, the reward fails, or a sensor is silent in all of
                three attempts.
        """
        if reason := self.set(values):
            return self._tuning.rejected, reason
        self._wait(self._tuning.trial.settle)
        return self._scored(), ""

    def set(self, values: Values) -> str:
        """Set the parameters; return why the node rejects them, or an empty text.

        Raises:
            SilentError: the node does not answer in time.
        """
        request = SetParametersAtomically.Request()
        request.parameters = [RosParameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self._peers.call(self._clients["set"], request, self.name, repeatable=True).result
        return "" if result.successful else (result.reason or "without a reason")

    def close(self) -> None:
        """Set the parameters to what they were before, and close the connection."""
        if self._node.context.ok():
            try:
                with deferred_signals():
                    self._require_set(self.before, "earlier")
                    self._file.unlink(missing_ok=True)
            finally:
                self._node.close()

    def keep(self, values: Values) -> None:
        """Set the parameters, and let them stay when the connection closes.

        Raises:
            RunError: the node rejects them, or is silent.
        """
        self._require_set(values, "best")
        self.before = values

    def _checked(self) -> dict[str, Any]:
        """Return the type of each parameter, after a check of their descriptors."""
        kinds = {}
        for name, ours in self._tuning.parameters.items():
            request, what = DescribeParameters.Request(names=[name]), f"parameter '{name}' of {self.name}"
            found = self._peers.call(self._clients["describe"], request, self.name, repeatable=True).descriptors
            require(
                len(found) == 1 and found[0].type != ParameterType.PARAMETER_NOT_SET, what, "a declared one", "none"
            )
            (descriptor,) = found  # its own name may be another one, if the node shares it between parameters
            require(descriptor.type in NUMBERS, what, "a double or an integer", f"type {descriptor.type}")
            require(not descriptor.read_only, what, "one that can be set", "a read-only one")
            for theirs in (*descriptor.floating_point_range, *descriptor.integer_range):
                good = theirs.from_value <= ours.minimum and ours.maximum <= theirs.to_value
                got = f"{ours.minimum:g} to {ours.maximum:g}"
                require(good, what, f"a range within {theirs.from_value:g} to {theirs.to_value:g}", got)
            kinds[name] = NUMBERS[descriptor.type]
        return kinds

    def _remembered(self) -> Values:
        """Return the values before the run, and write them to the file; after a kill they are those of the file."""
        if self._file.is_file():
            before: Values = yaml.safe_load(self._file.read_text())[self.name]["ros__parameters"]
            self._require_set(before, "earlier")
            return before
        request = GetParameters.Request(names=list(self._tuning.parameters))
        values = self._peers.call(self._clients["get"], request, self.name, repeatable=True).values
        before = dict(zip(self._tuning.parameters, map(parameter_value_to_python, values), strict=True))
        write_parameters(self._file, self.name, before)
        return before

    def _require_set(self, values: Values, which: str) -> None:
        if reason := self.set(values):
            raise RunError(f"{self.name}: expected the {which} parameters to be accepted, got: {reason}")

    def _scored(self) -> float:
        """Run the trial, again if a sensor was silent for a moment, and return its reward."""
        silent = ""
        for _ in range(ATTEMPTS):
            try:
                times, rows = self._record()
                heard = self._tuning.reward.heard(self._node.heard, time.monotonic(), self._tuning.stale_after)
                return self._tuning.reward.of(heard, times, rows)
            except SensingError as error:
                silent = str(error)
        raise RunError(f"trial: {silent}")

    def _record(self) -> tuple[Array, Array]:
        """Start a trial and record the sensors; return times, shape (k,), and observations, shape (k, d)."""
        trial = self._tuning.trial
        if self._starts:
            self._starts.publish(Empty())
        if self._start:
            self._peers.wait_for_service(self._start, trial.service)
            answer = self._peers.call(self._start, Trigger.Request(), trial.service)
            if not answer.success:
                raise RunError(f"{trial.service}: the trial did not start: {answer.message}")
        begin, count = time.monotonic(), max(1, round(trial.seconds / trial.period))
        times, rows = np.empty(count), []
        for row in range(count):
            self._wait(begin + (row + 1) * trial.period - time.monotonic())
            times[row] = time.monotonic() - begin
            rows.append(self._sensed())
        return times, np.array(rows)

    def _sensed(self) -> Array:
        return self._tuning.sensors.observation(self._node.heard, time.monotonic())

    def _wait(self, seconds: float) -> None:
        self._peers.spin(lambda: False, seconds)


def write_parameters(file: Path, node: str, values: Values) -> None:
    """Write parameters to a file that ``ros2 param load`` reads."""
    write_whole(file, yaml.safe_dump({node: {"ros__parameters": values}}, sort_keys=False).encode())
