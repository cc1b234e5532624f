"""The contents of a run's page; test/view tests the page in a browser."""

import re
import shutil
from base64 import b64decode
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from html import unescape
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.files import locked
from rkhs_ros.learning.iteration import Row
from rkhs_ros.pictures.known import ShowsBodies, names_of, scene_of
from rkhs_ros.pictures.run_pictures import curve_figure
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.storage import Task, load_policy
from rkhs_ros.recordings.container import MessageReader
from rkhs_ros.recordings.recording import FILE, read_recording
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve, columns
from rkhs_ros.runs.run import run_training
from sim_nodes.envs import TASKS

viser = pytest.importorskip("viser")

from rkhs_ros.pictures.policy_axes import PolicyAxes  # noqa: E402
from rkhs_ros.view.iteration_panel import IterationPanel  # noqa: E402
from rkhs_ros.view.page import status  # noqa: E402
from rkhs_ros.view.recorded import ENDED, FINISHED, RUNNING, Recorded, state_of  # noqa: E402
from rkhs_ros.view.serving import opened  # noqa: E402
from rkhs_ros.view.timeline import Timeline  # noqa: E402
from test.unit.conftest import random_episodes, random_policy  # noqa: E402

pytestmark = pytest.mark.slow

CONFIGS = Path(__file__).parents[3] / "config"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run with a recording."""
    config = load_config(CONFIGS / "pendulum_few_nac.yaml", ["iterations=4", "horizon=30", "evaluate_every=2"])
    path = tmp_path_factory.mktemp("view") / "run"
    return run_training(config, runner_of(config.environment), path, quiet=True)


def test_a_recording_contains_all_iterations(folder: Path) -> None:
    source, recording = Recorded(folder), read_recording(folder)
    rows = Curve(folder / "curve.csv").rows()
    for name in set(Row._fields) - {"seconds"}:
        assert np.array_equal(columns(source.rows)[name], columns(rows)[name], equal_nan=True)
    assert source.iterations == [1, 2, 3, 4]
    for number, (explored, evaluated) in zip(source.iterations, ((0, None), (1, 2), (3, None), (4, 5)), strict=True):
        loaded = source.load(number)
        assert np.array_equal(loaded.exploration.observations, recording.batches[explored].episodes.observations)
        assert (loaded.evaluation is None) == (evaluated is None)
        if evaluated is not None:
            assert np.array_equal(loaded.evaluation.actions, recording.batches[evaluated].episodes.actions)
    last, _ = load_policy(folder / "policy.npz")
    assert np.array_equal(source.load(4).policy.mean.weights, last.mean.weights)
    assert source.load(5) is None


def test_a_growing_recording_is_read_message_by_message(folder: Path, tmp_path: Path) -> None:
    whole = (folder / FILE).read_bytes()
    file, found = tmp_path / FILE, []
    file.touch()
    reader = MessageReader(file)
    for end in np.linspace(8, len(whole), 23).astype(int):
        with file.open("r+b") as growing:
            growing.write(whole[:end])
        found += reader.news().messages
    assert found == MessageReader(folder / FILE).news().messages
    assert reader.news().faults == []


def test_a_replaced_recording_is_read_from_its_start(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    shutil.copy(folder / FILE, file)
    source = Recorded(file)
    shutil.copy(folder / FILE, tmp_path / "aside")
    (tmp_path / "aside").replace(file)
    source.refresh()
    assert source.iterations == [1, 2, 3, 4]
    assert len(source.rows) == 4


@pytest.fixture(scope="module")
def model_update(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of model-based training with a recording."""
    changes = ["iterations=2", "horizon=20", "model.updates=1", "model.rollouts=2"]
    config = load_config(CONFIGS / "pendulum_model_nac.yaml", changes)
    path = tmp_path_factory.mktemp("model_based") / "run"
    return run_training(config, runner_of(config.environment), path, quiet=True)


def test_model_rollouts_start_from_real_states(model_update: Path) -> None:
    starts = Recorded(model_update).load(2).roll_out_model().observations[:, 0]
    real = read_recording(model_update).batches
    of_both = np.concatenate([each.episodes.observations[:, 0] for each in real if each.batch.explore])
    assert len(starts) == 3
    assert all((start == of_both).all(axis=1).any() for start in starts)


def test_no_host_does_not_stand_for_all_addresses() -> None:
    with pytest.raises(ValueError, match="host: expected an address of this machine, got none"):
        opened("", 0)


def test_model_rollouts_can_be_selected(model_update: Path) -> None:
    source = Recorded(model_update)
    server = opened("127.0.0.1", 0)
    try:
        showing = IterationPanel(server, source)
        iterations = {number: source.load(number) for number in (1, 2)}
        showing.show(iterations)
        (choice,) = (each for each in server.gui._gui_input_handle_from_uuid.values() if each.label == "Episode")
        choice.value = "model rollout 1"
        showing.show(iterations)
        assert showing.is_showing(2)
        assert np.array_equal(showing.episode.observations[0], source.load(2).roll_out_model().observations[0])
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def test_the_lock_determines_the_state_of_a_run(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "run"
    shutil.copytree(folder, path)
    source = Recorded(path)
    assert state_of(source) == FINISHED
    with locked(path):
        assert state_of(source) == RUNNING
    source.total = 5
    assert state_of(source) == ENDED
    assert "iteration 4 of 5" in status(source, ENDED)
    last = source.rows[-1]
    assert f"\n\n{last.episodes} episodes, {30 * last.episodes} steps, {last.centres} centres, " in status(
        source, ENDED
    )


def test_curves_of_several_runs_are_drawn_over_episodes(folder: Path) -> None:
    rows = Curve(folder / "curve.csv").rows()
    task = load_config(folder / "config.yaml").task
    figure = curve_figure(columns(rows), task, {"other": columns(rows[:2]), "not begun": columns([])})
    drawn = {line.get_label(): line.get_xydata().tolist() for line in figure.axes[0].lines}
    assert drawn["other"] == [[rows[1].episodes, rows[1].evaluation_return]]  # evaluated in every second iteration
    assert drawn["exploration"] == [[row.episodes, row.exploration_return] for row in rows]
    assert "not begun" not in drawn


@pytest.mark.parametrize("angles", ["none", (0.0, 2.0)])
def test_centres_are_converted_back_to_observations(angles: Any, rng: Any) -> None:
    inputs = Inputs(angles=angles)
    policy = random_policy(rng, d=inputs.dimension(3, 2))
    observed = rng.uniform(-3, 3, (5, 3))
    policy = replace(policy, mean=replace(policy.mean, centres=inputs.features(observed)), inputs=inputs)
    names = names_of(SimpleNamespace(environment="?"), 3, 2)
    assert np.allclose(PolicyAxes.of(policy, names, random_episodes(rng, random_policy(rng, d=3))).centres(), observed)


@pytest.mark.parametrize("environment", TASKS)
def test_tasks_define_a_scene(environment: str) -> None:
    task = scene_of(Task(environment, {}, 10, 0.99))
    assert isinstance(task, ShowsBodies)
    observations = np.linspace(-1, 1, 70).reshape(7, -1)[:, : TASKS[environment][0].single_observation_space.shape[0]]
    motion = task.motion(observations, np.ones((7, 1)))
    assert motion.positions.shape == (len(motion.times), len(task.bodies()), 3)
    assert np.allclose(np.linalg.norm(motion.orientations, axis=2), 1.0)


def test_a_task_without_a_scene_is_not_created_and_has_a_timeline(monkeypatch: pytest.MonkeyPatch) -> None:
    created = "gymnasium.envs.classic_control.Continuous_MountainCarEnv.__init__"
    monkeypatch.setattr(created, lambda *args, **options: pytest.fail("created"))
    assert scene_of(Task("MountainCarContinuous-v0", {}, 10, 0.99)) is None
    assert scene_of(Task("nobody/Knows-v0", {}, 10, 0.99)) is None
    timeline = Timeline(names_of(SimpleNamespace(environment="?"), 20, 2))
    motion = timeline.motion(np.arange(100.0).reshape(5, 20), np.zeros((5, 2)))
    assert motion.positions.shape == (5, len(timeline.bodies()), 3)
    assert (np.diff(motion.positions[:, 0, 0]) > 0).all()
    low, high = np.array(timeline.bounds)
    assert ((motion.positions[..., ::2] > low[::2]) & (motion.positions[..., ::2] < high[::2])).all()


def test_a_run_is_exported_as_a_page_that_needs_no_other_file(
    rkhs: Callable[..., Any], folder: Path, tmp_path: Path
) -> None:
    result = rkhs("export", folder, tmp_path / "run.html")
    assert (result.code, result.err) == (0, "")
    assert result.out == f"Exported the page of the run: {tmp_path / 'run.html'}\n"
    page = (tmp_path / "run.html").read_text()
    assert "Finished: iteration 4 of 4</p><p>20 episodes, " in page
    (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert b64decode(picture).startswith(b"\x89PNG")
    (scene,) = re.findall(r'srcdoc="([^"]+)"', page)
    assert unescape(scene).lstrip().lower().startswith("<!doctype html>")
    outside = [link for link in re.findall(r'(?:src|href)="([^"]*)"', page) if not link.startswith("data:")]
    assert outside == []
