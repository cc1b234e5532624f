"""Validated conversions between messages and values: batches, steps and tasks."""

from __future__ import annotations

import json
from array import array
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

import rkhs_interfaces.msg as msg
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.policies.inputs import MOST_INPUTS
from rkhs_ros.policies.messages import doubles, spaces_fields, viewed
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

if TYPE_CHECKING:  # a policy node needs no simulation
    from rkhs_ros.rollouts.simulation import Frame, Simulation

# Reliable. Volatile, because storing messages for late subscribers doubles the time of a round trip; nodes refuse to
# start a batch until their messages have subscribers.
LOCKSTEP_QOS = QoSProfile(depth=16, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # late subscribers receive the last one


def observation_message(identity: int, version: int, batch: Batch, step: int, frame: Frame) -> msg.Observation:
    """Return the simulator's message after ``step`` steps of a batch."""
    message = msg.Observation(batch=identity, policy_version=version, step=step, over=frame.is_over, **vars(batch))
    message.observations, message.rewards = doubles(frame.observations), doubles(frame.rewards)
    if not frame.is_whole:
        message.terminated, message.truncated = _indices_of(frame.terminated), _indices_of(frame.truncated)
    return message


def _indices_of(flags: ArrayLike) -> array[int]:
    return array("I", np.flatnonzero(flags).tolist())


def observations_of(message: msg.Observation, batch: Batch) -> Array:
    """Return the observations in a message of a batch, shape (num_envs, d); they share its memory."""
    if message.step + (not message.over) > batch.horizon:
        expected = f"at most {batch.horizon}, and less unless all episodes are over"
        raise ValueError(f"step: expected {expected}, got {message.step}")
    viewed(message.rewards, (batch.num_envs if message.step else 0,), "rewards")
    flat = message.observations
    columns = max(len(flat) // batch.num_envs, 1)
    if columns > MOST_INPUTS:
        raise ValueError(f"observations: expected at most {MOST_INPUTS} numbers per environment, got {columns}")
    return viewed(flat, (batch.num_envs, columns), "observations")


def batch_of(message: msg.Observation | StartEpisodes.Request) -> Batch:
    """Return the batch that a message belongs to; raise ValueError if a number is out of range."""
    return Batch(
        seed=message.seed,
        first_episode=message.first_episode,
        num_envs=message.num_envs,
        horizon=message.horizon,
        explore=message.explore,
    )


def describe(simulation: Simulation, num_envs: int) -> DescribeTask.Response:
    """Return a simulation's task, and how many of ``num_envs`` environments it can run in one batch."""
    space = simulation.observation_space
    return DescribeTask.Response(
        environment=simulation.environment,
        options=json.dumps(simulation.options),
        **spaces_fields(simulation.spaces),
        observation_type=space.dtype.name,
        observation_low=doubles(space.low),
        observation_high=doubles(space.high),
        horizon=simulation.time_limit or 0,
        capacity=simulation.capacity(num_envs),
        num_envs=simulation.num_envs,
    )
