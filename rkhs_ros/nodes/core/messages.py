"""Conversions between messages and the core's values: batches, steps, tasks; each is checked before it is used."""

from __future__ import annotations

import json
from array import array
from dataclasses import fields
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

import rkhs_interfaces.msg as msg
from rkhs_interfaces.srv import DescribeTask, SetPolicy, StartEpisodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import MOST_INPUTS, doubles, policy_message, spaces_fields, viewed
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

if TYPE_CHECKING:  # a policy node needs no simulation
    from sensor_msgs.msg import JointState

    from rkhs_ros.robot.episode import RobotEpisode
    from rkhs_ros.robot.task import RobotTask
    from rkhs_ros.rollouts.simulation import Frame, Simulation
    from rkhs_ros.rollouts.visualization import JointStates

# Reliable. Volatile, since keeping messages for late peers doubles the time of a round trip: the learner waits
# until the peers say that they are connected.
LOCKSTEP_QOS = QoSProfile(depth=16, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # for those who come later, too
batch_fields = attrgetter(*(field.name for field in fields(Batch)))  # of a message
CLOCK_ENDS = 2**31  # seconds, which /clock cannot tell any more


def observation_message(identity: int, version: int, batch: Batch, step: int, frame: Frame) -> msg.Observation:
    """Return what the simulator publishes after ``step`` steps of a batch."""
    message = msg.Observation(batch=identity, policy_version=version, **vars(batch))
    show(message, step, frame)
    return message


def show(message: msg.Observation, step: int, frame: Frame) -> None:
    """Fill in the message of a batch what it shows after ``step`` steps; to make a new one for each takes longer."""
    message.step, message.over = step, frame.is_over
    message.observations, message.rewards = doubles(frame.observations), doubles(frame.rewards)
    if not frame.is_whole:
        message.terminated, message.truncated = _rows_where(frame.terminated), _rows_where(frame.truncated)


def _rows_where(flags: ArrayLike) -> array[int]:
    """Return the rows of which something holds, from a flag for each."""
    return array("I", np.flatnonzero(flags).tolist())


def robot_observation_message(
    identity: int, version: int, batch: Batch, episode: RobotEpisode, step: int
) -> msg.Observation:
    """Return what the robot publishes after ``step`` steps of an episode."""
    return msg.Observation(
        batch=identity,
        policy_version=version,
        step=step,
        over=episode.complete,
        **vars(batch),
        observations=doubles(episode.observation),
        rewards=[] if episode.reward is None else [episode.reward],
        terminated=_rows_where([episode.complete and episode.terminated]),
        truncated=_rows_where([episode.complete and not episode.terminated]),
    )


def observations_of(message: msg.Observation, batch: Batch) -> Array:
    """Return the observations that a message of a batch carries, shape (rows, d); they share its memory.

    Raises:
        ValueError: the step cannot be, or they are misshapen or not finite; nor may the rewards be.
    """
    if message.step + (not message.over) > batch.horizon:
        expected = f"at most {batch.horizon}, and less unless all is over"
        raise ValueError(f"step: expected {expected}, got {message.step}")
    viewed(message.rewards, (batch.num_envs if message.step else 0,), "rewards")
    seen = message.observations
    columns = max(len(seen) // batch.num_envs, 1)
    if columns > MOST_INPUTS:
        raise ValueError(f"observations: expected at most {MOST_INPUTS} numbers a row, got {columns}")
    return viewed(seen, (batch.num_envs, columns), "observations")


def batch_of(message: msg.Observation | StartEpisodes.Request) -> Batch:
    """Return the batch that a message is of.

    Raises:
        ValueError: a number is out of range.
    """
    return Batch(
        seed=message.seed,
        first_episode=message.first_episode,
        num_envs=message.num_envs,
        horizon=message.horizon,
        explore=message.explore,
        num_evaluation=message.num_evaluation,
        first_evaluation=message.first_evaluation,
    )


def start_request(
    identity: int, version: int, batch: Batch, task: DescribeTask.Response, clock: int, *, anew: bool = False
) -> StartEpisodes.Request:
    """Return the request to start a batch of a task; a robot runs it ``anew`` even where it finished it before."""
    return StartEpisodes.Request(
        batch=identity,
        policy_version=version,
        environment=task.environment,
        options=task.options,
        clock=clock,
        anew=anew,
        **vars(batch),
    )


def set_policy_request(policy: GaussianPolicy, version: int) -> SetPolicy.Request:
    """Return the request to serve a policy."""
    return SetPolicy.Request(policy=policy_message(msg, policy, version))


def describe(
    simulation: Simulation, rows: int, identity: int, step: int, clock: int, *, failure: str, connected: bool
) -> DescribeTask.Response:
    """Return what a simulation's task is, how many of so many rows it has room for, and how far it is."""
    space = simulation.observation_space
    return DescribeTask.Response(
        environment=simulation.environment,
        options=json.dumps(simulation.options),
        **spaces_fields(simulation.spaces),
        observation_type=space.dtype.name,
        observation_low=doubles(space.low),
        observation_high=doubles(space.high),
        horizon=simulation.own_horizon or 0,
        capacity=simulation.capacity(rows),
        num_envs=simulation.num_envs,
        batch=identity,
        step=step,
        failure=failure,
        clock=clock,
        connected=connected,
    )


def describe_robot(
    task: RobotTask, identity: int, step: int, *, failure: str, connected: bool
) -> DescribeTask.Response:
    """Return what a robot's task is, and how far it is; what it waits for is to be added."""
    return DescribeTask.Response(
        environment=task.task,
        options="{}",
        **spaces_fields(task.spaces),
        capacity=1,
        num_envs=1,
        batch=identity,
        step=step,
        failure=failure,
        connected=connected,
        period=task.period,
        learner_timeout=task.learner_timeout,
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
