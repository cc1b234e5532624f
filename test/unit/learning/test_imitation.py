"""Policies fitted to demonstrations."""

from pathlib import Path

import numpy as np
import pytest
from sklearn.kernel_ridge import KernelRidge

from rkhs_ros.learning.imitation import Imitation
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.episode_files import load_episodes, save_episodes
from test.unit.conftest import random_episodes, random_policy

SPACES = Spaces.unbounded(2, 2)


def test_with_all_states_as_centres_it_is_kernel_ridge_regression(rng: np.random.Generator) -> None:
    shown = random_episodes(rng, random_policy(rng), n=5, horizon=6, masked=True)
    points, actions = shown.flat(shown.observations), shown.flat(shown.actions)
    fitted = Imitation(centres=len(points), ridge=0.01, kernel=KernelChoice(bandwidth=(0.7,))).fit(shown, SPACES)
    oracle = KernelRidge(alpha=0.01 * len(points), kernel="rbf", gamma=0.5 / 0.7**2).fit(points, actions)
    x = np.linspace(-2, 2, 30).reshape(15, 2)
    np.testing.assert_allclose(fitted.mean(x), oracle.predict(x), atol=1e-8)
    residual = actions - fitted.mean(points)
    np.testing.assert_allclose(fitted.variance(x)[0], np.mean(residual**2, axis=0))


def test_an_imitated_policy_that_holds_its_actions_is_fitted_to_its_decisions(rng: np.random.Generator) -> None:
    decided = random_episodes(rng, random_policy(rng), n=5, horizon=6)
    fitted = Imitation(action_repeat=3, centres=10).fit(decided.held(3, 18), SPACES)
    alike = Imitation(centres=10).fit(decided, SPACES)
    assert fitted.action_repeat == 3
    assert np.array_equal(fitted.mean.centres, alike.mean.centres)
    assert np.array_equal(fitted.mean.weights, alike.mean.weights)
    assert np.array_equal(fitted.variance.values, alike.variance.values)


def test_saved_episodes_are_read_back_with_optional_fields_missing(tmp_path: Path, rng: np.random.Generator) -> None:
    shown, task = random_episodes(rng, random_policy(rng), masked=True), Task("Pendulum-v1", {"g": 9.0}, 8, 0.9)
    save_episodes(tmp_path / "e.npz", shown, task)
    back, known = load_episodes(tmp_path / "e.npz")
    assert known == task
    for name in ("observations", "actions", "rewards", "mask", "final_observations", "terminated"):
        assert np.array_equal(getattr(back, name), getattr(shown, name))
    np.savez(tmp_path / "few.npz", observations=shown.observations, actions=shown.actions)
    few, known = load_episodes(tmp_path / "few.npz")
    assert known is None
    assert few.mask.all()
    assert not few.rewards.any()
    assert np.array_equal(few.final_observations, shown.observations[:, -1])


SHOWN = {"observations": np.zeros((2, 3, 1)), "actions": np.zeros((2, 3, 1))}


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"actions": np.zeros((2, 3, 1))}, "arrays: expected an array observations, got actions"),
        ({"observations": np.full((2, 3, 1), np.nan), "actions": np.zeros((2, 3, 1))}, "observations: expected finite"),
        (SHOWN | {"rewards": np.zeros((2, 3), dtype=complex)}, "rewards: expected real numbers"),
        (SHOWN | {"mask": np.full((2, 3), "True")}, "mask: expected Boolean values"),
        (SHOWN | {"final_observations": np.full((2, 1), np.nan)}, "final_observations: expected finite"),
        (SHOWN | {"terminated": np.zeros((2, 3), dtype=bool)}, "terminated: expected the shape"),
    ],
)
def test_files_without_valid_episodes_raise_a_one_line_error(
    tmp_path: Path, arrays: dict[str, np.ndarray], message: str
) -> None:
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(ValueError, match=rf"bad\.npz: expected a file of episodes.*{message}") as refusal:
        load_episodes(tmp_path / "bad.npz")
    assert "\n" not in str(refusal.value)
