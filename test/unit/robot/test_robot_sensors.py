"""Observations from a robot's messages, and refused fields."""

from types import SimpleNamespace as Message

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.robot.sensors import ReceivedMessage, SensingError, Sensor, Sensors, field_values, paths_of

NUMBERS = st.floats(-1e6, 1e6)
IMU = Message(linear_acceleration=Message(x=1.0, y=2.0, z=3.0), covariance=[4.0, 5.0, 6.0])
POSES = Message(poses=[Message(position=Message(x=1.0)), Message(position=Message(x=2.0))], ok=True)


@pytest.mark.parametrize(
    ("message", "path", "values"),
    [
        (IMU, "linear_acceleration.z", [3.0]),
        (IMU, "covariance[1]", [5.0]),
        (IMU, "covariance[0:3]", [4.0, 5.0, 6.0]),
        (POSES, "poses[1].position.x", [2.0]),
        (POSES, "ok", [1.0]),
    ],
)
def test_a_path_selects_numbers(message: Message, path: str, values: list[float]) -> None:
    assert field_values(message, path) == values


@pytest.mark.parametrize("path", ["", "a..b", "a[", "a[1:1]", "a[0:2].b", "a[0:99999]"])
def test_an_invalid_path_is_refused(path: str) -> None:
    with pytest.raises(ValueError, match="field: expected"):
        paths_of(path)


@pytest.mark.parametrize("path", ["nothing", "linear_acceleration", "covariance[3]", "covariance"])
def test_a_field_that_is_not_a_number_is_reported(path: str) -> None:
    with pytest.raises(SensingError, match="expected a number"):
        field_values(IMU, path)


@given(st.permutations(["a", "b", "c"]), st.lists(NUMBERS, min_size=6, max_size=6))
def test_joints_are_found_by_name_in_any_order(names: list[str], values: list[float]) -> None:
    message = Message(name=names, position=values[:3], velocity=values[3:], effort=[])
    seen = Sensor("j", fields=("position", "velocity"), joints=("c", "a")).numbers(message)
    position, velocity = dict(zip(names, values[:3], strict=True)), dict(zip(names, values[3:], strict=True))
    assert seen == [position["c"], position["a"], velocity["c"], velocity["a"]]


@pytest.mark.parametrize(
    ("sensor", "names"),
    [
        (Sensor("j", joints=("b", "a")), "b position (rad), a position (rad), b velocity (rad/s), a velocity (rad/s)"),
        (Sensor("j", joints=("a",), fields=("effort",), units=("N",)), "a effort (N)"),
        (Sensor("p", "a/msg/B", ("pose.position.x", "twist.angular.z")), "tip position.x (m), tip angular.z (rad/s)"),
        (Sensor("p", "a/msg/B", ("data[1:3]", "level")), "tip data[1], tip data[2], tip level"),
        (Sensor("p", "a/msg/B", ("data[1:3]",), units=("m",)), "tip data[1] (m), tip data[2] (m)"),
    ],
)
def test_values_are_named_by_joint_or_field_with_their_unit(sensor: Sensor, names: str) -> None:
    assert ", ".join(sensor.names("tip")) == names
    assert len(sensor.names("tip")) == sensor.dimension


def test_a_missing_joint_or_field_is_named() -> None:
    message = Message(name=["a"], position=[1.0], velocity=[], effort=[])
    with pytest.raises(SensingError, match="missing joints 'b', got a"):
        Sensor("j", joints=("b",)).numbers(message)
    with pytest.raises(SensingError, match="velocity: expected a value for joint 'a', got 0 values"):
        Sensor("j", joints=("a",)).numbers(message)


def test_the_observation_is_sorted_by_sensor_name() -> None:
    sensors = {n: Sensor(n, type="std_msgs/msg/Float64", fields=("data",)) for n in ("second", "first", "third")}
    values = {"first": 1.0, "second": 2.0, "third": 3.0}
    heard = {name: ReceivedMessage(Message(data=value), 0.0) for name, value in values.items()}
    np.testing.assert_array_equal(Sensors(sensors, 0.1).observation(heard, 0.05), [1.0, 2.0, 3.0])


@given(age=st.floats(0.0, 1.0), stale_after=st.floats(0.001, 1.0))
def test_a_message_is_valid_until_it_is_stale(age: float, stale_after: float) -> None:
    sensors = Sensors({"s": Sensor("t", type="std_msgs/msg/Float64", fields=("data",))}, stale_after)
    heard = {"t": ReceivedMessage(Message(data=1.0), 5.0)}
    if 5.0 + age - 5.0 > stale_after:
        with pytest.raises(SensingError, match="sensor s: stale"):
            sensors.observation(heard, 5.0 + age)
    else:
        assert sensors.observation(heard, 5.0 + age) == [1.0]


def test_a_silent_sensor_and_a_nan_are_reported_with_the_sensors_name() -> None:
    sensors = Sensors({"s": Sensor("t", type="std_msgs/msg/Float64", fields=("data",))}, 0.1)
    with pytest.raises(SensingError, match="sensor s: no message has arrived on t"):
        sensors.observation({}, 0.0)
    with pytest.raises(SensingError, match="sensor s: t: expected finite numbers"):
        sensors.observation({"t": ReceivedMessage(Message(data=float("nan")), 0.0)}, 0.0)
