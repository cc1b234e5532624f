import hashlib
import math
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.spatial.transform import Rotation

from sim_nodes.pr2.motion import ARM, RATE, TOOL_OFFSET, Motion, adapted, arm_chain, demonstration, finger_angle, gap

pytest.importorskip("pybullet", reason="PyBullet is not installed")

from sim_nodes.pr2.environment import POSE_SD, PR2Door
from sim_nodes.pr2.world import OPENED, UNLATCHED, VELOCITY, Trajectory, latched

pytestmark = pytest.mark.slow

TASK = "rkhs/PR2Door-v0"
STRAIGHT = np.zeros(3)
CHAIN = arm_chain()
PIVOT = 0.88  # m, of the lever, along x


@pytest.fixture(scope="module")
def task() -> Iterator[PR2Door]:
    made = PR2Door()
    yield made
    made.close()


@pytest.fixture
def angles(rng: np.random.Generator) -> np.ndarray:
    """Angles of the arm within its limits, shape (20, 7)."""
    return rng.uniform(np.maximum(CHAIN.lower, -3.0), np.minimum(CHAIN.upper, 3.0), (20, 7))


def trajectory(task: PR2Door, pose: np.ndarray, action: list[float]) -> Trajectory:
    done = task.attempt(pose, np.array(action)).trajectory
    assert done is not None
    return done


def digest(done: Trajectory) -> str:
    return hashlib.sha256(b"".join(getattr(done, field.name).tobytes() for field in fields(done))).hexdigest()


def digests_of_some_episodes(task: PR2Door) -> list[str]:
    cases = [([0.0, 0.0], [0.0, 0.0, 0.0]), ([-0.03, 0.01], [0.01, -0.03, 0.02]), ([0.05, -0.06], [-0.01, 0.0, 0.05])]
    return [digest(trajectory(task, np.array(pose), action)) for action, pose in cases]


def hold(seconds: float = 1.0) -> Motion:
    """Return a motion that stays where the demonstration begins, clear of the door."""
    start = demonstration()
    knots = round(RATE * seconds) + 1
    return Motion(np.tile(start.arm[0], (knots, 1)), np.full(knots, start.openings[0]))


# Kinematics


def test_forward_kinematics_equals_rotating_joint_by_joint(angles: np.ndarray) -> None:
    position, rotation = CHAIN.forward(angles)
    for q, p, r in zip(angles, position, rotation, strict=True):
        place, turn = np.array([-0.05, 0.0, 0.051 + 0.889675]), Rotation.identity()
        for joint, angle in zip(ARM, q, strict=True):
            place, turn = place + turn.apply(joint.origin), turn * Rotation.from_rotvec(angle * np.array(joint.axis))
        np.testing.assert_allclose(p, place + turn.apply([0.18, 0.0, 0.0]), atol=1e-12)
        np.testing.assert_allclose(r, turn.as_matrix(), atol=1e-12)


def test_the_jacobian_equals_the_derivative(angles: np.ndarray) -> None:
    jacobian, h = CHAIN.forward_and_jacobian(angles)[2], 1e-6
    for joint, step in enumerate(h * np.eye(7)):
        (ahead, turned_ahead), (behind, turned_behind) = CHAIN.forward(angles + step), CHAIN.forward(angles - step)
        np.testing.assert_allclose(jacobian[:, :3, joint], (ahead - behind) / (2 * h), atol=1e-8)
        turned = Rotation.from_matrix(turned_ahead @ turned_behind.swapaxes(1, 2)).as_rotvec() / (2 * h)
        np.testing.assert_allclose(jacobian[:, 3:, joint], turned, atol=1e-8)


def test_solutions_reach_the_requested_pose(rng: np.random.Generator) -> None:
    goal = demonstration()
    q, errors = CHAIN.solve(goal.arm + rng.normal(scale=0.2, size=goal.arm.shape), goal.positions, goal.rotations)
    position, rotation = CHAIN.forward(q)
    np.testing.assert_allclose(position, goal.positions, atol=1e-5)
    np.testing.assert_allclose(rotation, goal.rotations, atol=1e-5)
    assert np.all(errors < 1e-5)
    assert np.all((q >= CHAIN.lower) & (q <= CHAIN.upper))


def test_openings_and_finger_angles_are_inverse() -> None:
    assert gap(0.3) == pytest.approx(2 * (0.09137 * np.sin(0.3) + 0.00495 * np.cos(0.3) - 0.00495), rel=1e-12)
    assert finger_angle(gap(0.3)) == pytest.approx(0.3, abs=1e-12)


def test_the_latch_releases_above_30_degrees_and_engages_below_half_a_degree() -> None:
    cases = ((True, 0.6, 29.0, True), (True, 0.0, 31.0, False), (False, 0.4, 29.0, True), (False, 0.6, 29.0, False))
    for before, opened, turned, after in cases:
        assert latched(before, math.radians(opened), math.radians(turned)) is after


# Physics


@pytest.mark.parametrize(("lever", "torque", "opens"), [(0.0, 60.0, False), (40.0, 60.0, True), (40.0, 19.0, False)])
def test_the_door_stays_shut_without_the_lever_and_against_its_friction(
    task: PR2Door, lever: float, torque: float, opens: bool
) -> None:
    world = task.world
    world._reset(hold(), STRAIGHT)
    for _ in range(120):
        world.client.resetJointState(world._door, world._lever, np.deg2rad(lever))
        world.client.applyExternalTorque(world._door, world._hinge, (0.0, 0.0, -torque), world.client.WORLD_FRAME)
        world._simulate()
    angle = world.client.getJointState(world._door, world._hinge)[0]
    assert (angle > OPENED) is opens
    if not opens:
        assert abs(angle) < np.deg2rad(0.1)


def test_the_motors_respect_their_velocity_limits(task: PR2Door) -> None:
    motion = hold()
    rushed = Motion(motion.arm.copy(), motion.openings.copy())
    rushed.arm[10:, -1] += 3.0  # at once
    rushed.openings[10:] = 0.0
    done = task.world.run(rushed, STRAIGHT)
    speeds = RATE * np.abs(np.diff(done.positions, axis=0))
    assert np.all(speeds <= VELOCITY * 1.01)
    assert speeds[:, 6].max() > 0.9 * VELOCITY[6]
    assert done.openings[12] > 0.02


def test_the_tool_is_where_the_simulator_has_it_and_between_the_drawn_finger_tips(task: PR2Door) -> None:
    pose, world = np.array([0.02, -0.03, 0.1]), task.world
    done = world.run(adapted(demonstration(), np.zeros(2)), pose)
    links = {world.client.getJointInfo(world._robot, i)[12].decode(): i for i in range(16)}
    palm = world.client.getLinkState(world._robot, links["r_gripper_palm_link"], computeForwardKinematics=True)
    np.testing.assert_allclose(done.tool[-1], palm[4] + Rotation.from_quat(palm[5]).apply(TOOL_OFFSET), atol=1e-6)
    motion = task.motion(pose[None] / POSE_SD, -task.start[None])
    assert motion.positions.shape == (len(done.door), len(task.bodies()), 3)
    fingers = [links[f"r_gripper_{side}_finger_tip_link"] for side in "lr"]
    tips = [i for i, visual in enumerate(world._visuals) if visual[0] == world._robot and visual[1] in fingers]
    middle = motion.positions[:, tips].mean(axis=1)
    assert np.linalg.norm(middle - done.tool, axis=1).max() < 0.02


# Episodes


def test_the_demonstration_opens_the_door_with_nearly_the_greatest_reward(task: PR2Door) -> None:
    outcome = task.attempt(STRAIGHT, np.zeros(2))
    assert outcome.reward >= 0.98
    assert outcome.success
    assert np.degrees(outcome.door_angle) == pytest.approx(16.0, abs=1.0)
    assert outcome.reward == pytest.approx(np.exp(-outcome.tracking_error))


def test_actions_that_open_the_door_are_contiguous_and_inside_the_bounds(task: PR2Door) -> None:
    shifts = np.linspace(-0.2, 0.2, 17)
    opened = [task.attempt(STRAIGHT, np.array([shift, -0.015])).success for shift in shifts]
    assert 1 <= sum(opened) <= 6
    assert not any(opened[:1] + opened[-1:])
    first = opened.index(True)
    assert all(opened[first : first + sum(opened)])


def test_an_open_gripper_does_not_drag_the_door_with_one_finger(task: PR2Door) -> None:
    widest = task.single_action_space.high[1]
    tried = [task.attempt(STRAIGHT, np.array([shift, widest])) for shift in np.linspace(-0.2, 0.2, 15)]
    turned = [outcome.trajectory is not None and outcome.trajectory.lever.max() > UNLATCHED for outcome in tried]
    assert any(turned)  # so a finger does press the lever down, past the latch
    assert not any(outcome.success for outcome in tried)


def test_an_error_of_the_pose_is_corrected_by_the_action(task: PR2Door) -> None:
    pose = np.array([-0.01, 0.02, 0.05])
    shift = -(pose[1] + pose[2] * PIVOT)
    uncorrected, corrected = (task.attempt(pose, np.array([a, 0.0])) for a in (0.0, shift))
    assert corrected.success
    assert corrected.reward > 0.85
    assert uncorrected.reward < corrected.reward - 0.3


def test_an_unreachable_motion_has_no_reward(task: PR2Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task, "single_action_space", gymnasium.spaces.Box(-2.0, 2.0, (2,), np.float64))
    outcome = task.attempt(STRAIGHT, np.array([0.9, 0.0]))
    assert adapted(demonstration(), np.array([0.9, 0.0])) is None
    assert (outcome.reward, outcome.success, outcome.door_angle) == (0.0, False, 0.0)
    assert outcome.tracking_error == np.inf


# Determinism


def test_an_episode_is_bit_identical_after_others_and_in_a_new_world(task: PR2Door) -> None:
    first = digests_of_some_episodes(task)
    assert len(set(first)) == 3
    assert digests_of_some_episodes(task) == first
    other = PR2Door()
    alone = digest(trajectory(other, np.array([-0.01, 0.02, 0.03]), [0.0, 0.0]))
    assert alone not in first
    assert digests_of_some_episodes(other) == first
    other.close_extras()
    assert digest(trajectory(other, np.array([-0.01, 0.02, 0.03]), [0.0, 0.0])) == alone
    other.close()


def test_an_episode_is_bit_identical_in_another_process(task: PR2Door) -> None:
    code = "import test_pr2; print(*test_pr2.digests_of_some_episodes(test_pr2.PR2Door()))"
    path = [*sys.path, str(Path(__file__).parent)]
    setup = f"import sys; sys.path[:] = {path!r}; "
    ended = subprocess.run([sys.executable, "-c", setup + code], capture_output=True, text=True, check=True)
    assert ended.stdout.split("\n")[-2].split() == digests_of_some_episodes(task)


# The environment


def play(task: PR2Door, actions: np.ndarray, seed: list[int]) -> tuple[np.ndarray, np.ndarray]:
    observations, _ = task.reset(seed=seed)
    return observations, task.step(actions)[1]


def test_an_action_is_added_to_the_start_and_both_are_clipped() -> None:
    actions = [[0.0, 0.0], [-0.05, -0.04], [0.18, 0.06], [-9.0, -9.0]]
    changes = [[0.05, 0.04], [0.0, 0.0], [0.2, 0.08], [-0.15, -0.04]]
    np.testing.assert_allclose(PR2Door().change(np.array(actions)), changes, atol=1e-15)
    assert np.array_equal(PR2Door(start=[0.0, 0.0]).change(np.array([0.18, -0.06])), [0.18, -0.06])


def test_a_pose_is_drawn_per_run_or_per_episode_from_the_seed() -> None:
    kept, same, other = (PR2Door(2, pose_seed=s) for s in (1, 1, 2))
    first = kept.reset(seed=[3, 4])[0]
    assert np.array_equal(first[0], first[1])
    assert np.array_equal(kept.reset(seed=[8, 9])[0], first)
    assert np.array_equal(same.reset(seed=0)[0], first)
    assert not np.any(other.reset(seed=0)[0] == first)
    drawn = PR2Door(2, pose="per_episode")
    poses = drawn.reset(seed=[3, 4])[0]
    stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(4)))
    np.testing.assert_allclose(poses[1], stream.standard_normal(3), rtol=1e-12)
    assert not np.any(drawn.reset()[0] == poses)


def test_an_episode_has_one_action_and_the_next_step_resets() -> None:
    task = PR2Door(2, max_episode_steps=12, pose="per_episode")
    first = task.reset(seed=[0, 1])[0]
    seen, rewards, terminated, truncated, info = task.step(np.zeros((2, 2)))
    assert np.array_equal(seen, first)
    assert terminated.all()
    assert not truncated.any()
    assert np.all(rewards > 0)
    assert {name: values.shape for name, values in info.items()} == dict.fromkeys(info, (2,))
    assert set(info) == {"success", "door_angle", "tracking_error"}
    anew, nothing, terminated, _, info = task.step(np.zeros((2, 2)))
    assert not np.any(anew == first)
    assert not np.any([nothing, terminated])
    assert info == {}


def test_a_single_environment_equals_one_of_the_vector_environment() -> None:
    single = gymnasium.make(TASK, pose="per_episode")
    action = np.array([-0.02, 0.01])
    observations, rewards = play(PR2Door(2, pose="per_episode"), np.tile(action, (2, 1)), [3, 4])
    assert np.array_equal(single.reset(seed=4)[0], observations[1])
    observation, reward, terminated, truncated, info = single.step(action)
    assert np.array_equal(observation, observations[1])
    assert (reward, terminated, truncated) == (rewards[1], True, True)
    assert isinstance(info["success"], bool)
    single.close()


def test_gymnasiums_checker_passes() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")  # the actions are in metres
        warnings.filterwarnings("ignore", message=".*Box observation space m.* value is .*infinity")  # a normal error
        check_env(gymnasium.make(TASK).unwrapped, skip_render_check=True)


@pytest.mark.nightly
def test_pictures_show_the_start_and_the_motion_whether_or_not_the_arm_can_reach(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = gymnasium.make(TASK, render_mode="rgb_array_list")
    env.reset(seed=0)
    (start,) = env.render()
    env.step(-PR2Door().start)
    frames = env.render()
    assert len(frames) == 29  # five per second, after the first
    assert len({frame.tobytes() for frame in frames}) > 25  # at the end it holds still
    monkeypatch.setattr("sim_nodes.pr2.environment.adapted", lambda *_: None)
    one = gymnasium.make(TASK, render_mode="rgb_array")
    one.reset(seed=0)
    one.step(np.zeros(2))
    np.testing.assert_array_equal(one.render(), start)


def test_without_pybullet_the_task_is_registered_and_names_what_to_install() -> None:
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; sys.modules['pybullet'] = None\n"
        "import gymnasium, sim_nodes.envs\n"
        "from rkhs_ros.rollouts.simulation import Simulation\n"
        f"gymnasium.spec('{TASK}')\n"
        f"try: gymnasium.make('{TASK}')\n"
        "except ImportError as error: print(error)\n"
        f"try: Simulation('{TASK}')\n"
        "except ValueError as error: print(error)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = ended.stdout.splitlines()
    assert len(lines) == 2
    assert all("pip install pybullet==3.2.7" in line for line in lines)
