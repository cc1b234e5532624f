"""Conversions between messages and the core's values: batches, episodes, tasks; each is checked before it is used."""

from __future__ import annotations

import json
from array import array
from collections.abc import Sequence
from dataclasses import fields
from math import prod
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

import rkhs_interfaces.msg as msg
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.base.validation import finite_array, require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.execution import Execution
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

if TYPE_CHECKING:  # a policy node needs no simulation
    from sensor_msgs.msg import JointState

    from rkhs_ros.robot.episode import RobotEpisode
    from rkhs_ros.robot.task import RobotTask
    from rkhs_ros.runs.shown import JointStates
    from rkhs_ros.runs.simulation import Frame, Simulation

# Reliable. Volatile, since keeping messages for late peers doubles the time of a round trip: the learner waits
# until the peers say that they are connected.
LOCKSTEP_QOS = QoSProfile(depth=16, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
MOST_INPUTS, MOST_ACTIONS = 100_000, 1_000  # dimensions of a policy
BATCH = attrgetter(*(field.name for field in fields(Batch)))  # what a message says of its batch
FLOATS = ("float32", "float64")  # types of actions
CLOCK_ENDS = 2**31  # seconds, which /clock cannot tell any more


def doubles(values: NDArray[Any]) -> array[float]:
    """Return the values as what a float64[] field takes fastest."""
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def matrix(values: Any, rows: int, columns: int, what: str) -> Array:
    """Return a float64[] field as a finite matrix of its own.

    Raises:
        ValueError: another number of values, or some that are not finite.
    """
    return _numbers(values, (rows, columns), what)


def _numbers(values: Any, shape: tuple[int, ...], what: str) -> Array:
    if len(values) != prod(shape):  # seen before they are copied: there may be millions
        raise ValueError(f"{what}: expected {shape} values, got {len(values)}")
    return finite_array(np.frombuffer(values, dtype=np.float64), shape, what)


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


def episodes_message(
    identity: int, version: int, episodes: Episodes, executions: Sequence[Execution] = ()
) -> msg.Episodes:
    """Return what a simulator, or a robot, publishes at the end of a batch."""
    rows, horizon = episodes.rewards.shape
    return msg.Episodes(
        batch=identity,
        policy_version=version,
        rows=rows,
        horizon=horizon,
        lengths=array("I", episodes.mask.sum(axis=1).astype(np.uint32).tobytes()),
        terminated=episodes.terminated.tolist(),
        observations=doubles(episodes.observations),
        final_observations=doubles(episodes.final_observations),
        actions=doubles(episodes.actions),
        rewards=doubles(episodes.rewards),
        executions=[_execution_message(execution) for execution in executions],
    )


def _execution_message(execution: Execution) -> msg.Execution:
    return msg.Execution(
        stamps=array("q", execution.stamps.tobytes()),
        executed=doubles(execution.executed),
        flags=array("I", execution.flags.astype(np.uint32).tobytes()),
        void_reason=execution.void_reason,
    )


def executions_of(message: msg.Episodes) -> list[Execution]:
    """Return how the episodes that a message carries went on a robot; nothing of a simulator's.

    Raises:
        ValueError: it is not told for each episode, or the numbers do not fit together.
    """
    count = len(message.executions)
    require(count in (0, message.rows), "executions", f"none, or {message.rows}, one for each episode", count)
    return [_execution_of(each, steps) for each, steps in zip(message.executions, message.lengths, strict=False)]


def _execution_of(message: msg.Execution, steps: int) -> Execution:
    width = len(message.executed) // max(steps, 1)
    return Execution(
        stamps=np.array(message.stamps, dtype=np.int64),
        executed=_numbers(message.executed, (steps, width), "executed commands"),
        flags=np.array(message.flags, dtype=np.uint32),
        void_reason=message.void_reason,
    )


def episodes_of(message: msg.Episodes, batch: Batch, spaces: Spaces) -> Episodes:
    """Return the episodes that a message carries; one that is void may have no steps.

    Raises:
        ValueError: they are not of that batch's size, or not finite.
    """
    shape = (batch.rows, batch.horizon)
    require((message.rows, message.horizon) == shape, "episodes", f"{shape}", f"{(message.rows, message.horizon)}")
    for name in ("lengths", "terminated"):
        size = len(getattr(message, name))
        require(size == batch.rows, f"episodes' {name}", f"{batch.rows} entries", size)
    lengths = np.array(message.lengths, dtype=np.int64)
    least = 0 if any(execution.void_reason for execution in message.executions) else 1
    good = bool(((lengths >= least) & (lengths <= batch.horizon)).all())
    require(good, "episodes' lengths", f"{least} to {batch.horizon} steps", lengths)
    return Episodes(
        observations=_numbers(message.observations, (*shape, spaces.observation_dim), "episodes' observations"),
        actions=_numbers(message.actions, (*shape, spaces.action_dim), "episodes' actions"),
        rewards=_numbers(message.rewards, shape, "episodes' rewards"),
        mask=np.arange(batch.horizon) < lengths[:, None],
        final_observations=_numbers(
            message.final_observations, (batch.rows, spaces.observation_dim), "episodes' final observations"
        ),
        terminated=np.array(message.terminated, dtype=bool),
    )


def describe(
    simulation: Simulation, rows: int, identity: int, step: int, clock: int, *, failure: str, connected: bool
) -> DescribeTask.Response:
    """Return what a simulation's task is, how many of so many rows it has room for, and how far it is."""
    spaces = simulation.spaces
    return DescribeTask.Response(
        environment=simulation.environment,
        options=json.dumps(simulation.options),
        observation_shape=spaces.observation_shape,
        action_shape=spaces.action_low.shape,
        action_type=spaces.action_low.dtype.name,
        action_low=doubles(spaces.action_low),
        action_high=doubles(spaces.action_high),
        room=simulation.room(rows),
        rows_at_once=simulation.rows_at_once,
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
    spaces = task.spaces
    return DescribeTask.Response(
        environment=task.task,
        options="{}",
        observation_shape=spaces.observation_shape,
        action_shape=spaces.action_low.shape,
        action_type=spaces.action_low.dtype.name,
        action_low=doubles(spaces.action_low),
        action_high=doubles(spaces.action_high),
        room=1,
        rows_at_once=1,
        batch=identity,
        step=step,
        failure=failure,
        connected=connected,
        period=task.period,
        learner_timeout=task.learner_timeout,
    )


def spaces_of(message: DescribeTask.Response) -> Spaces:
    """Return the spaces of the task that a message describes.

    Raises:
        ValueError: the shapes, the type or the bounds do not fit.
    """
    require(message.action_type in FLOATS, "action_type", f"one of {', '.join(FLOATS)}", message.action_type)
    shape = tuple(int(size) for size in message.action_shape)
    sizes = (prod(message.observation_shape), prod(shape))
    good = 1 <= sizes[0] <= MOST_INPUTS and 1 <= sizes[1] <= MOST_ACTIONS
    require(good, "task", f"1 to {MOST_INPUTS} observed numbers and 1 to {MOST_ACTIONS} actions", sizes)
    bounds = (np.array(bound, dtype=message.action_type) for bound in (message.action_low, message.action_high))
    low, high = (bound.reshape(shape) if bound.size == sizes[1] else bound for bound in bounds)
    require(low.shape == shape, "action_low", f"{shape} values", low.shape)
    return Spaces(tuple(int(size) for size in message.observation_shape), low, high)


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
