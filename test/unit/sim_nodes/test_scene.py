"""Pictures of scenes: silhouettes, depth, and the render modes of all tasks."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import AddRenderObservation, RenderCollection
from hypothesis import given, settings, strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from sim_nodes.envs.scene import BLUE, FINER, ORANGE, Body, Camera, matrices, quaternions

BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
STILL = np.array([1.0, 0.0, 0.0, 0.0])
seeds = st.integers(0, 10_000)


def surface(shape: str, rng: np.random.Generator) -> np.ndarray:
    """Return points on the surface of a shape between -1 and 1, among them all extreme ones; shape (k, 3)."""
    if shape == "box":
        return np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    points = rng.normal(size=(4000, 3))
    if shape == "ball":
        return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))
    turn = np.linspace(0.0, 2 * np.pi, 400)
    return np.concatenate([np.stack([np.cos(turn), np.sin(turn), 0 * turn + end], axis=1) for end in (-1.0, 1.0)])


@settings(max_examples=12)
@given(shape=st.sampled_from(["box", "ball", "cylinder"]), seed=seeds)
def test_a_body_covers_the_hull_of_its_projected_points(shape: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size, place, turn = rng.uniform(0.3, 1.0, 3), rng.uniform(-0.4, 0.4, 3), Rotation.random(random_state=seed)
    camera = Camera(tuple(rng.normal(size=3)), BOX, (240, 180))
    body = Body(shape, (size[0], size[0], size[2]), BLUE)
    points = place + turn.apply(surface(shape, rng) * np.array(body.size) / 2)
    hull = ConvexHull(camera._seen(points) / FINER)
    picture = camera.picture([body], place[None], np.roll(turn.as_quat(), 1)[None])
    painted = (picture < 254).any(axis=2)
    assert painted.sum() == pytest.approx(hull.volume, rel=0.05, abs=60)  # in two dimensions, the volume is the area
    rows, columns = np.nonzero(painted)
    corners = np.stack([columns + 0.5, rows + 0.5], axis=1)
    assert (corners @ hull.equations[:, :2].T + hull.equations[:, 2] <= 1.0).all()  # within a pixel of the hull


@given(seed=seeds)
def test_quaternions_and_matrices_are_inverse(seed: int) -> None:
    turns = Rotation.random(5, random_state=seed)
    np.testing.assert_allclose(matrices(quaternions(turns.as_matrix())), turns.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(matrices(np.roll(turns.as_quat(), 1, axis=1)), turns.as_matrix(), atol=1e-12)


@pytest.mark.parametrize(("near", "seen"), [(0.5, ORANGE), (-0.5, BLUE)])
def test_the_nearer_body_hides_the_other_in_any_order(near: float, seen: str) -> None:
    camera = Camera((1.0, 0.0, 0.0), BOX, (60, 60))
    bodies = [Body("ball", (0.6, 0.6, 0.6), BLUE), Body("box", (0.4, 0.4, 0.4), ORANGE)]
    places = np.array([[0.0, 0.0, 0.0], [near, 0.0, 0.0]])
    for order in ([0, 1], [1, 0]):
        picture = camera.picture([bodies[k] for k in order], places[order], np.tile(STILL, (2, 1)))
        shade = picture[30, 30] / np.array(list(bytes.fromhex(seen[1:]))).clip(1)
        assert np.ptp(shade[np.array(list(bytes.fromhex(seen[1:]))) > 20]) < 0.05  # the same colour, darker or lighter


@pytest.mark.parametrize("task", ["rkhs/Pendulum-v0", "rkhs/CartPoleSwingUp-v0"])
def test_gymnasiums_wrappers_take_the_pictures_of_a_task(task: str, rng: np.random.Generator) -> None:
    env = gymnasium.make(task, render_mode="rgb_array")
    assert env.metadata["render_fps"] == max(round(1 / env.unwrapped.task.step_seconds), 5)
    collected: Any = RenderCollection(env)
    collected.reset(seed=0)
    actions = rng.uniform(env.action_space.low, env.action_space.high, (3, *env.action_space.shape))
    for action in actions:
        collected.step(action)
    frames = collected.render()
    assert [(frame.shape, frame.dtype) for frame in frames] == [((360, 480, 3), np.uint8)] * 4
    assert len({frame.tobytes() for frame in frames}) == 4
    seen, _ = AddRenderObservation(env).reset(seed=0)
    np.testing.assert_array_equal(seen, frames[0])
    vector = gymnasium.make_vec(task, 2, vectorization_mode="vector_entry_point", render_mode="rgb_array")
    vector.reset(seed=[0, 1])
    np.testing.assert_array_equal(vector.render()[0], frames[0])
    np.testing.assert_array_equal(vector.step(np.stack([actions[0]] * 2))[0].shape[0], 2)
    np.testing.assert_array_equal(vector.render()[0], frames[1])
