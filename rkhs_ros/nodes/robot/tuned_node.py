"""The connection to a node whose parameters are tuned: it checks and sets them, runs trials, and restores them."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from rkhs_ros.base.endings import RunError, deferred_signals
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS
from rkhs_ros.nodes.core.peers import ClientNode
from rkhs_ros.nodes.core.spin import names_reported
from rkhs_ros.nodes.robot.sensor_topics import SENSOR_QOS, types_of
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.sensors import ReceivedMessage, SensingError
from rkhs_ros.robot.tuning import Tuning

Values = dict[str, Any]
BEFORE = "parameters_before.yaml"  # in the run's folder while they may be changed
NUMBERS: dict[int, Callable[[float], float | int]] = {
    ParameterType.PARAMETER_DOUBLE: float,
    ParameterType.PARAMETER_INTEGER: round,
}
KINDS = ("nothing", "a bool", "an integer", "a double", "a string")  # by `ParameterType`; the others are lists
DISCOVERY_S = 1.0  # to see other runs that tune the node
CALLS = {
    "describe_parameters": DescribeParameters,
    "get_parameters": GetParameters,
    "set_parameters_atomically": SetParametersAtomically,
}


class TunedNode(ClientNode):
    """The connection to a node whose parameters are tuned.

    Owns the newest message of each topic, and the values that the parameters had before: they are set again when the
    connection closes, and are in a file in `folder` until then, from which the next connection sets them.
    """

    def __init__(self, tuning: Tuning, folder: Path) -> None:
        topics = [(sensor.topic, sensor.type, sensor.fields) for _, sensor in tuning.sensors]
        if tuning.reward.topic:
            topics.append((tuning.reward.topic, tuning.reward.type, (tuning.reward.field,)))
        types = types_of(topics)  # before there is a node to close
        super().__init__("tuning", tuning.timeout)
        self._tuning, self._file = tuning, folder / BEFORE
        self._heard: dict[str, ReceivedMessage] = {}
        self.tuned, trial = tuning.node if tuning.node.startswith("/") else f"/{tuning.node}", tuning.trial
        try:
            with names_reported(self):
                for topic, kind in types.items():
                    self.create_subscription(kind, topic, partial(self._hear, topic), SENSOR_QOS)
                self._calls = {name: self.create_client(kind, f"{self.tuned}/{name}") for name, kind in CALLS.items()}
                self._start = self.create_client(Trigger, trial.service) if trial.service else None
                self._starts = self.create_publisher(Empty, trial.topic, LOCKSTEP_QOS) if trial.topic else None
            for client in self._calls.values():
                self.peers.wait_for_service(client, self.tuned)
            self._values = {name: self._checked(name) for name in tuning.parameters}
            self.before = self._remembered()
        except BaseException:
            super().close()
            raise

    def values(self, places: Array) -> Values:
        """Return the values at the places in their ranges, of the types of the parameters."""
        return {name: value(place) for (name, value), place in zip(self._values.items(), places, strict=True)}

    def sense_context(self) -> Array:
        """Return the context, shape (c,), once all sensors are heard; raise RunError if one is silent or unusable."""
        self._heard.clear()  # what was heard before the next trial was chosen is old
        topics = {sensor.topic for _, sensor in self._tuning.sensors}
        self.peers.spin(lambda: topics <= self._heard.keys(), self._tuning.timeout)
        return self._sensed()[[self._tuning.sensors.names.index(name) for name in self._tuning.context]]

    def trial(self, values: Values) -> tuple[float, str]:
        """Run a trial; return its reward, and why the node rejects the values, or an empty text."""
        if reason := self._set(values):
            return self._tuning.rejected, reason
        self._wait(self._tuning.trial.settle)
        times, rows = self._record()
        try:
            heard = self._tuning.reward.heard(self._heard, time.monotonic(), self._tuning.stale_after)
        except SensingError as error:
            raise RunError(f"trial: {error}") from error
        return self._tuning.reward.of(heard, times, rows), ""

    def close(self) -> None:
        """Set the parameters to what they were before, and close the connection."""
        if self.context.ok():
            try:
                with deferred_signals():
                    self._require_set(self.before, "earlier")
                    self._file.unlink(missing_ok=True)
            finally:
                super().close()

    def keep(self, values: Values) -> None:
        """Set the parameters, and let them stay when the connection closes; raise RunError if the node rejects them."""
        self._require_set(values, "best")
        self.before = values

    def _call(self, name: str, **fields: Any) -> Any:
        return self.peers.call(self._calls[name], CALLS[name].Request(**fields), self.tuned, repeatable=True)

    def _checked(self, name: str) -> Callable[[float], float | int]:
        """Check the descriptor of a parameter; return the function from a place in its range to its value."""
        ours, what = self._tuning.parameters[name], f"parameter '{name}' of {self.tuned}"
        found = self._call("describe_parameters", names=[name]).descriptors
        require(len(found) == 1 and found[0].type != ParameterType.PARAMETER_NOT_SET, what, "a declared one", "none")
        (descriptor,) = found
        require(descriptor.type in NUMBERS, what, "a double or an integer", [*KINDS, *["a list"] * 5][descriptor.type])
        require(not descriptor.read_only, what, "one that can be set", "a read-only one")
        kind, got = NUMBERS[descriptor.type], f"{ours.minimum:g} to {ours.maximum:g}"
        origin, step = 0.0, float(kind is round)
        for theirs in (*descriptor.floating_point_range, *descriptor.integer_range):
            good = theirs.from_value <= ours.minimum and ours.maximum <= theirs.to_value
            require(good, what, f"a range within {theirs.from_value:g} to {theirs.to_value:g}", got)
            origin, step = theirs.from_value, max(theirs.step, step)
        value = partial(ours.value, origin=origin, step=step)
        require(value(-1.0) < value(1.0), what, f"a range with two values in steps of {step:g}", got)
        return lambda place: kind(value(place))

    def _is_tuned_twice(self) -> bool:
        service = f"{self.tuned}/set_parameters_atomically"
        return self.get_node_names().count(self.get_name()) > 1 and self.count_clients(service) > 1

    def _remembered(self) -> Values:
        """Return the values before the run, and write them to the file; after a kill they are those of the file."""
        if self._file.is_file():
            try:
                before: Values = dict(yaml.safe_load(self._file.read_text())[self.tuned]["ros__parameters"])
            except (yaml.YAMLError, TypeError, KeyError) as error:
                remedy = f"Set the parameters of {self.tuned} yourself, and delete the file"
                raise ValueError(f"{self._file}: expected the parameters from before, got none. {remedy}") from error
            self._require_set(before, "earlier")
            return before
        if self.peers.spin(self._is_tuned_twice, DISCOVERY_S):
            raise RunError(f"{self.tuned}: expected a node that no other run tunes, got one that another run tunes")
        values = self._call("get_parameters", names=list(self._tuning.parameters)).values
        before = dict(zip(self._tuning.parameters, map(parameter_value_to_python, values), strict=True))
        write_parameters(self._file, self.tuned, before)
        return before

    def _set(self, values: Values) -> str:
        """Set the parameters; return why the node rejects them, or an empty text."""
        messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self._call("set_parameters_atomically", parameters=messages).result
        return "" if result.successful else (result.reason or "without a reason")

    def _require_set(self, values: Values, which: str) -> None:
        if reason := self._set(values):
            raise RunError(f"{self.tuned}: expected the {which} parameters to be accepted, got: {reason}")

    def _record(self) -> tuple[Array, Array]:
        """Start a trial and record the sensors; return times, shape (k,), and observations, shape (k, d)."""
        trial = self._tuning.trial
        if self._starts:
            self._starts.publish(Empty())
        if self._start:
            named = f"{trial.service} service's"  # such as "the ... service's node did not answer"
            self.peers.wait_for_service(self._start, named)
            answer = self.peers.call(self._start, Trigger.Request(), named)
            if not answer.success:
                raise RunError(f"{trial.service}: the trial did not start: {answer.message}")
        begin, count = time.monotonic(), max(1, round(trial.seconds / trial.period))
        times, rows = np.empty(count), []
        for row in range(count):
            self._wait(begin + (row + 1) * trial.period - time.monotonic())
            times[row] = time.monotonic() - begin
            rows.append(self._sensed())
        return times, np.array(rows)

    def _hear(self, topic: str, message: Any) -> None:
        self._heard[topic] = ReceivedMessage(message, time.monotonic())

    def _sensed(self) -> Array:
        try:
            return self._tuning.sensors.observation(self._heard, time.monotonic())
        except SensingError as error:
            raise RunError(f"trial: {error}") from error

    def _wait(self, seconds: float) -> None:
        self.peers.spin(lambda: False, seconds)


def write_parameters(file: Path, node: str, values: Values) -> None:
    """Write parameters to a file that ``ros2 param load`` reads."""
    write_whole(file, yaml.safe_dump({node: {"ros__parameters": values}}, sort_keys=False).encode())
