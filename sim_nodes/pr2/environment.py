"""The robotic manipulation task of section 4.4 of the paper: a PR2 opens a door, with one action per episode."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box

from sim_nodes.envs.scene import Array, Body, BodyTrajectories, Camera, Pixels
from sim_nodes.envs.vector_task import SingleTask, VectorTask, clip
from sim_nodes.pr2.motion import RATE, SECONDS, Demonstration, Motion, adapted, demonstration
from sim_nodes.pr2.world import OPENED, Trajectory, World, knots

POSES = ("per_run", "per_episode")
POSE_SD = np.array([0.015, 0.05, 0.05])  # of the base: x, y (m), yaw (rad)
START = (0.05, 0.04)  # m: a poor first guess of the grip position and the opening
TRACKING_SCALE = 0.05  # m
FPS = 5  # pictures per second of a motion
FRAMED = (-0.2, -0.7, 0.45), (0.9, 0.5, 1.5)  # m, corners of what a picture shows


class Outcome(NamedTuple):
    """Outcome of a changed demonstration."""

    reward: float  # from 0 to 1
    success: bool  # whether the door is open at the end
    door_angle: float  # at the end, rad
    tracking_error: float  # the first part of the cost; infinite if the arm cannot reach the path
    trajectory: Trajectory | None  # the executed motion; None if the arm cannot reach the path


class PR2Door(VectorTask):
    r"""Open a door by changing a demonstration, which was recorded at another pose of the robot's base.

    The observation is the error of the base's pose: :math:`(x / 0.015\,m, y / 0.05\,m, yaw / 0.05\,rad)`, standard
    normal. The action, in metres, is added to ``start``, a poor first guess. The sum, the change, shifts the fingers
    along the lever (to the left) by at most 0.2, and widens their opening by at most 0.08. The robot executes the
    changed demonstration in the frame of its base:

    .. math:: r = \exp(-R_1 - R_2), \qquad R_1 = \frac{\text{mean} \|x - x_{demo}\|^2 +
        \text{mean} (w - w_{demo})^2}{(0.05\,m)^2}

    with the tool's position x in the world and the opening w. :math:`R_2` is 0 if the door is open by more than 5
    degrees at the end, otherwise 1. The reward is 0 if the arm cannot reach the path. An episode has one action. The
    environments run in sequence, each from the same state of the simulator, so they are independent.

    Owns the simulator, which is created at the first action, and the outcomes of the last episodes.

    Args:
        num_envs: number of environments.
        max_episode_steps: ignored, because an episode has one step.
        pose: draw the error once ("per_run"), or for each episode from the environment's seed ("per_episode").
        pose_seed: seed of the "per_run" error.
        start: the change for the action (0, 0), two numbers in metres. It is added to the clipped action; the sum is
            clipped to the same bounds.
        render_mode: "rgb_array" for a picture of the end of the motion, "rgb_array_list" for pictures of the whole
            motion; None for none.
    """

    metadata = {**VectorTask.metadata, "render_modes": ["rgb_array", "rgb_array_list"], "render_fps": FPS}

    single_observation_space = Box(-np.inf, np.inf, (3,), np.float64)
    single_action_space = Box(np.array([-0.2, -0.08]), np.array([0.2, 0.08]), dtype=np.float64)
    view_direction = (-0.75, -1.0, 0.55)
    bounds = (-0.4, -0.9, 0.0), (0.9, 1.0, 2.2)
    observation_names: tuple[str, ...] = ("error in x (sd)", "error in y (sd)", "error in yaw (sd)")
    action_names: tuple[str, ...] = ("shift along the lever (m)", "change of the opening (m)")
    success_reward = float(np.exp(-1.0))  # the greatest reward without opening the door
    start_noise_dim, noise_dim = 3, 0
    step_seconds = SECONDS

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        pose: str = "per_run",
        pose_seed: int = 0,
        start: Sequence[float] = START,
        render_mode: str | None = None,
    ) -> None:
        if pose not in POSES:
            raise ValueError(f"pose: expected one of {', '.join(POSES)}, got '{pose}'")
        super().__init__(num_envs, 1, render_mode)
        self.pose = pose
        self.pose_seed = pose_seed
        self.start = np.array(start, dtype=np.float64)
        self.outcomes: list[Outcome] = []
        self._is_drawn = False  # since the last step

    @cached_property
    def world(self) -> World:
        """The simulator."""
        return World()

    def initial_states(self, noise: Array) -> Array:
        """Return the errors of the pose: x, y in metres, yaw in radians; shape (num_envs, 3)."""
        if self.pose == "per_run":
            return np.tile(POSE_SD * np.random.default_rng(self.pose_seed).standard_normal(3), (len(noise), 1))
        return POSE_SD * noise

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        return states

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        pairs = zip(states, self.change(actions), strict=True)
        self.outcomes = [self.attempt(state, change) for state, change in pairs]
        return np.array([outcome.reward for outcome in self.outcomes])

    def observe(self, states: Array, noise: Array) -> Array:  # noqa: D102
        return np.asarray(states / POSE_SD)

    def step(self, actions: Array) -> tuple[Array, Any, Any, Any, dict[str, Any]]:
        """Execute an action in every environment; the step after that resets them.

        The info has ``success``, ``door_angle`` (rad) and ``tracking_error`` (:math:`R_1`) of each environment.
        """
        self._is_drawn = False
        observations, rewards, _, over, _ = super().step(actions)
        names = ("success", "door_angle", "tracking_error") if over.all() else ()
        info = {name: np.array([getattr(outcome, name) for outcome in self.outcomes]) for name in names}
        return observations, rewards, over, np.zeros_like(over), info

    def change(self, actions: Array) -> Array:
        """Return the changes of the demonstration for actions, shape (2,) or (num_envs, 2)."""
        low, high = self.single_action_space.low, self.single_action_space.high
        return clip(self.start + clip(actions, low, high), low, high)

    def attempt(self, pose: Array, change: Array) -> Outcome:
        """Return the outcome of a changed demonstration with an error x, y, yaw of the base's pose.

        The change is the sum of the action and ``start``, and is clipped; (0, 0) is the demonstration.
        """
        shown = demonstration()
        motion = adapted(shown, clip(change, self.single_action_space.low, self.single_action_space.high))
        if motion is None:
            return Outcome(0.0, False, 0.0, float("inf"), None)
        trajectory = self.world.run(motion, pose)
        error, angle = tracking_error(trajectory, shown), float(trajectory.door[-1])
        success = angle > OPENED
        return Outcome(float(np.exp(-error - (not success))), success, angle, error, trajectory)

    def close_extras(self, **kwargs: Any) -> None:
        """Close the simulator."""
        if world := self.__dict__.pop("world", None):
            world.close()

    def bodies(self) -> list[Body]:
        """Return the visible bodies: the robot, the door and the wall."""
        return self.world.bodies()

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories | None:
        """Execute an episode's action again, and return the trajectories; None if the arm cannot reach."""
        pose = observations[0] * POSE_SD
        trajectory = self.attempt(pose, self.change(actions[0])).trajectory
        return None if trajectory is None else self._trajectories(pose, trajectory)

    def reset(self, **options: Any) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every environment, as in `VectorTask.reset`."""
        self.outcomes, self._is_drawn = [], False
        return super().reset(**options)

    def render(self) -> tuple[Any, ...] | None:
        """Return the picture of each environment, or its pictures since the last call; None without a render mode."""
        if self.render_mode is None:
            return None
        moves = [outcome.trajectory for outcome in self.outcomes] or [None] * self.num_envs
        if self.render_mode == "rgb_array":
            return tuple(self._pictures(*each, slice(-1, None))[0] for each in zip(self._states, moves, strict=True))
        every = slice(RATE // FPS if self.outcomes else 0, 0 if self._is_drawn else None, RATE // FPS)
        self._is_drawn = True
        return tuple(self._pictures(*each, every) for each in zip(self._states, moves, strict=True))

    def _pictures(self, pose: Array, trajectory: Trajectory | None, which: slice) -> list[Pixels]:
        """Return the pictures of some moments of a motion; one of the start if there is none."""
        motion, camera, bodies = (
            self._trajectories(pose, trajectory),
            Camera(self.view_direction, FRAMED),
            self.bodies(),
        )
        moments = zip(motion.positions[which], motion.orientations[which], strict=True)
        return [camera.picture(bodies, *moment) for moment in moments]

    def _trajectories(self, pose: Array, trajectory: Trajectory | None) -> BodyTrajectories:
        """Return the trajectories of all boxes in a motion; those at the start if there is none."""
        if trajectory is None:
            start = demonstration()
            positions, turned = knots(Motion(start.arm[:1], start.openings[:1])), np.zeros((1, 2))
        else:
            positions, turned = trajectory.positions, np.stack([trajectory.door, trajectory.lever], axis=1)
        return BodyTrajectories(np.arange(len(positions)) / RATE, *self.world.poses(positions, turned, pose))


def tracking_error(trajectory: Trajectory, shown: Demonstration) -> float:
    """Return the mean squared distance of tool and gripper opening from the demonstration, over TRACKING_SCALE**2."""
    place = np.sum((trajectory.tool - shown.positions) ** 2, axis=1)
    opening = (trajectory.openings - shown.openings) ** 2
    return float((np.mean(place) + np.mean(opening)) / TRACKING_SCALE**2)


def single(**options: Any) -> SingleTask:
    """Return the task as a single Gymnasium environment, with options of `PR2Door`."""
    return SingleTask(PR2Door(**options))
