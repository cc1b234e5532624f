"""Conversions between messages and the core's values: batches, steps, tasks; each is checked before it is used."""

from __future__ import annotations

import json
from dataclasses import fields
from operator import attrgetter
from typing import TYPE_CHECKING

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

import rkhs_interfaces.msg as msg
from rkhs_interfaces.srv import DescribeTask, SetPolicy, StartEpisodes
from rkhs_ros.base.validation import require
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import MOST_INPUTS, doubles, matrix, policy_message, spaces_fields
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

if TYPE_CHECKING:  # a policy node needs no simulation
    from sensor_msgs.msg import JointState

    from rkhs_ros.runs.shown import JointStates
    from rkhs_ros.runs.simulation import Frame, Simulation

# Reliable. Volatile, since keeping messages for late peers doubles the time of a round trip: the learner waits
# until the peers say that they are connected.
LOCKSTEP_QOS = QoSProfile(depth=16, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
BATCH = attrgetter(*(field.name for field in fields(Batch)))  # what a message says of its batch
CLOCK_ENDS = 2**31  # seconds, which /clock cannot tell any more


def observation_message(identity: int, version: int, batch: Batch, step: int, frame: Frame) -> msg.Observation:
    """Return what the simulator publishes after ``step`` steps of a batch."""
    return msg.Observation(
        batch=identity,
        policy_version=version,
        step=step,
        over=not frame.active.any(),
        **vars(batch),
        observations=doubles(frame.observations),
        rewards=doubles(frame.rewards),
    )


def observations_of(message: msg.Observation, batch: Batch) -> Array:
    """Return the observations that a message carries, shape (rows, d).

    Raises:
        ValueError: they are not of that batch, misshapen or not finite; nor may the rewards be.
    """
    if BATCH(message) != BATCH(batch):  # no text is made unless it is needed: every step comes by here
        raise ValueError(f"batch {message.batch}: expected {batch}, got {batch_of(message)}")
    if message.step + (not message.over) > batch.horizon:
        expected = f"at most {batch.horizon}, and less unless all is over"
        raise ValueError(f"step: expected {expected}, got {message.step}")
    matrix(message.rewards, batch.rows if message.step else 0, 1, "rewards")
    columns = max(len(message.observations) // batch.rows, 1)
    require(columns <= MOST_INPUTS, "observations", f"at most {MOST_INPUTS} numbers a row", columns)
    return matrix(message.observations, batch.rows, columns, "observations")


def batch_of(message: msg.Observation | StartEpisodes.Request) -> Batch:
    """Return the batch that a message is of.

    Raises:
        ValueError: a number is out of range.
    """
    return Batch(
        seed=message.seed,
        first_episode=message.first_episode,
        rows=message.rows,
        horizon=message.horizon,
        explore=message.explore,
    )


def start_request(
    identity: int, version: int, batch: Batch, task: DescribeTask.Response, clock: int
) -> StartEpisodes.Request:
    """Return the request to start a batch of a task."""
    return StartEpisodes.Request(
        batch=identity,
        policy_version=version,
        environment=task.environment,
        options=task.options,
        clock=clock,
        **vars(batch),
    )


def set_policy_request(policy: GaussianPolicy, version: int) -> SetPolicy.Request:
    """Return the request to serve a policy."""
    return SetPolicy.Request(policy=policy_message(msg, policy, version))


def describe(
    simulation: Simulation, rows: int, identity: int, step: int, clock: int, *, failure: str, connected: bool
) -> DescribeTask.Response:
    """Return what a simulation's task is, how many of so many rows it has room for, and how far it is."""
    return DescribeTask.Response(
        environment=simulation.environment,
        options=json.dumps(simulation.options),
        **spaces_fields(simulation.spaces),
        room=simulation.room(rows),
        rows_at_once=simulation.rows_at_once,
        batch=identity,
        step=step,
        failure=failure,
        clock=clock,
        connected=connected,
    )


def clock_message(seconds: float) -> Clock:
    """Return a time since the beginning of the run as what goes to /clock."""
    return Clock(clock=Time(nanoseconds=round(1e9 * seconds)).to_msg())


def joint_state_messages(states: JointStates, begin: int) -> list[JointState]:
    """Return a motion as messages, stamped from ``begin`` on, in nanoseconds."""
    from sensor_msgs.msg import JointState  # here, since it takes 0.1 s and few nodes need it
    from std_msgs.msg import Header

    stamps = (begin + round(1e9 * states.period * knot) for knot in range(len(states.positions)))
    return [
        JointState(
            header=Header(stamp=Time(nanoseconds=stamp).to_msg()), name=states.names, position=doubles(positions)
        )
        for stamp, positions in zip(stamps, states.positions, strict=True)
    ]
