import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.app.cli import COMMANDS
from rkhs_ros.app.task_check import TaskCheck
from rkhs_ros.base import validation
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, load_policy, save_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import Result, assert_refused, model_free, random_policy

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
SHORT = ("--runner", "inline", "--iterations", "2")
Run = Callable[..., Result]


@pytest.fixture
def policy_file(rng: np.random.Generator, tmp_path: Path) -> Path:
    path = tmp_path / "toy.npz"
    save_policy(path, random_policy(rng, d=1, n=1), Task("rkhs/Toy-v0", {}, 20, 0.9))
    return path


def test_list_shows_tasks_algorithms_and_kernels(rkhs: Run) -> None:
    result = rkhs("list")
    assert (result.code, result.err) == (0, "")
    for name in ("rkhs/Toy-v0", "rkhs/Pendulum-v0", "rkhs_nac", "rkhs_power", "rbf", "polynomial"):
        assert name in result.out


def test_train_writes_its_results_and_prints_their_paths(rkhs: Run, tmp_path: Path) -> None:
    result = rkhs("train", CONFIG, *SHORT, "--quiet", "--out", tmp_path / "run", "--seed", 3, "--set", "horizon=5")
    assert (result.code, result.err) == (0, "")
    names = {"best_policy.npz", "config.yaml", "curve.csv", "curve.png", "policy.npz", "policy.png"}
    names |= {"final_evaluation.txt", "lock", "recording.mcap"}
    assert {path.name for path in (tmp_path / "run").iterdir()} == names
    assert result.out.startswith("Trained on rkhs/Toy-v0 for 20 episodes")
    assert str(tmp_path / "run" / "curve.png") in result.out
    config = (tmp_path / "run" / "config.yaml").read_text()
    assert "seed: 3" in config
    assert "horizon: 5" in config
    assert len((tmp_path / "run" / "curve.csv").read_text().splitlines()) == 1 + 2
    (tmp_path / "run" / "policy.npz").unlink()  # as while it runs
    plotted = rkhs("plot", tmp_path / "run")
    assert (plotted.code, len(plotted.out.splitlines())) == (0, 2)
    assert "the run has not finished; using its best policy so far" in plotted.err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("horizn=5", "unknown key 'horizn', did you mean 'horizon'?"),
        ("environment.id=rkhs/Toi-v0", "unknown environment 'rkhs/Toi-v0', did you mean 'rkhs/Toy-v0'?"),
        ("environment.id=CartPole-v1", "CartPole-v1 actions: expected a continuous space"),
        ("centres=20", "unknown key 'centres', did you mean 'algorithm.centres' or 'model.centres'?"),
        ("algorithm.name=enac", " (algorithm={name: enac} selects 'enac' with its defaults)"),
        ("name=1e5", "name: expected text (quote words that YAML reads as another type), got 100000.0"),
    ],
)
def test_an_invalid_setting_gives_one_line(rkhs: Run, change: str, message: str) -> None:
    assert_refused(rkhs("train", CONFIG, *SHORT, "--quiet", "--set", change), message)


def test_a_missing_file_gives_one_line(rkhs: Run, tmp_path: Path) -> None:
    assert_refused(rkhs("train", "none.yaml", *SHORT), "none.yaml: no such configuration\n")
    assert_refused(rkhs("train", "Pendulum-v1"), "no such configuration. For an environment, use --env Pendulum-v1\n")
    assert_refused(rkhs("train", tmp_path, *SHORT), f"{tmp_path}: expected a configuration file, got a folder\n")
    assert_refused(rkhs("evaluate", "none"), "none: expected an existing file or folder, got none")
    assert_refused(rkhs("train", CONFIG, *SHORT, "--out", Path(__file__) / "run"), "run: not a directory\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["evaluate", "render", "plot"])
def test_a_folder_without_a_last_policy_is_rejected_with_a_hint(rkhs: Run, tmp_path: Path, command: str) -> None:
    run = tmp_path / "runs" / "one"
    run.mkdir(parents=True)
    (run / "config.yaml").write_bytes(CONFIG.read_bytes())
    named = (
        f"runs: expected the folder of a run, got none with a config.yaml. Pass one of the runs in it, such as {run}"
    )
    assert_refused(rkhs(command, tmp_path / "runs"), named)
    refusal = "policy.npz: expected a policy, got none since the run has not finished"
    assert_refused(rkhs(command, run), f"{refusal}. Continue with: rkhs train --resume {run}\n")
    assert_refused(rkhs("train", run), f"got a folder. To resume a run, use --resume {run}")


def test_a_command_imports_no_drawing_library() -> None:
    code = (
        "import sys\nfrom rkhs_ros.app.cli import main\n"
        "try: main(sys.argv[1:])\nexcept SystemExit: print('modules:', *sys.modules)"
    )
    loaded = {"--help": {"numpy", "yaml"}, "robot": {"matplotlib", "gymnasium"}, "evaluate": {"matplotlib", "joblib"}}
    for word, absent in loaded.items():
        done = subprocess.run([sys.executable, "-c", code, word, "--help"], capture_output=True, text=True, check=True)
        assert not absent & set(done.stdout.rpartition("modules:")[2].split()), word


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(rkhs: Run, command: str) -> None:
    code, out, err = rkhs(command, "--help")
    assert (code, err) == (0, "")
    assert out.startswith(f"usage: rkhs {command} ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "the following arguments are required: COMMAND"),
        (("trian",), "unknown command 'trian', did you mean 'train'?"),
        (("train", "a.yaml", "--seed", "x"), "argument --seed: invalid int value: 'x' (see 'rkhs train --help')"),
        (("train", "x.yaml", "--algorithm", "RKHSNAC"), "unknown algorithm 'RKHSNAC', did you mean 'rkhs_nac'?"),
        (("evaluate", ""), "argument DIR|FILE: expected a path, got an empty text (see 'rkhs evaluate --help')"),
    ],
)
def test_invalid_arguments_give_one_line(rkhs: Run, arguments: tuple[str, ...], message: str) -> None:
    assert_refused(rkhs(*arguments), message)


def test_an_interrupt_during_an_import_gives_one_line(tmp_path: Path) -> None:
    interrupting = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
    (tmp_path / "gymnasium.py").write_text(interrupting)  # shadows a dependency of the command
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"}
    command = [sys.executable, "-m", "rkhs_ros.app.cli", "list"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


@pytest.mark.parametrize("code", [0, 1])
def test_a_reader_that_stops_early_is_no_error(code: int) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "rkhs_ros.app.cli", "list", *["--wrong"][:code]]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr.count("\n")) == (2 * code, code)


# Choice of the runner


def test_without_ros_a_run_is_inline_with_a_note(rkhs: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation, "find_spec", lambda name: None)
    code, _, err = rkhs("train", CONFIG, "--iterations", 1, "--quiet", "--out", "run")
    assert (code, err.count("\n")) == (0, 1)
    assert err.startswith("note: training with --runner inline, since there is no rclpy and rkhs_interfaces for Python")
    expected = "--runner ros: expected ROS 2 Jazzy and the built interfaces, got no rclpy and rkhs_interfaces"
    assert_refused(rkhs("train", CONFIG, "--runner", "ros", "--out", "other"), expected)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


# Pictures and evaluation of a policy


def test_evaluate_measures_with_and_without_discount(rkhs: Run, policy_file: Path, rng: np.random.Generator) -> None:
    values = json.loads(rkhs("evaluate", policy_file, "--episodes", 5, "--discount", 0.5).out)
    policy, task = load_policy(policy_file)
    rewards = InlineRunner(Simulation("rkhs/Toy-v0")).collect(policy, Batch(0, 0, 5, 20, explore=False)).rewards
    assert (values["discount"], task.discount) == (0.5, 0.9)
    for measured, discount in ((values, 0.5), (values["undiscounted"], 1.0)):
        returns = (rewards * discount ** np.arange(20)).sum(axis=1)
        half = 2.7764451 * np.sqrt(((returns - returns.mean()) ** 2).sum() / 4 / 5)  # 0.975 of Student's t, 4 degrees
        assert measured["mean"] == pytest.approx(returns.mean(), rel=1e-12)
        assert measured["sd"] == pytest.approx(returns.std(), rel=1e-9)
        assert measured["interval_95"] == pytest.approx([returns.mean() - half, returns.mean() + half], rel=1e-7)


def test_the_policy_of_a_robot_is_not_evaluated_in_another_environment(rkhs: Run, policy_file: Path) -> None:
    (policy_file.parent / "config.yaml").write_text(CONFIG.with_name("robot_pendulum.yaml").read_text())
    refused = rkhs("evaluate", policy_file, "--env", "Pendulum-v1")
    assert_refused(refused, "--env: expected none for a policy of a robot, got Pendulum-v1")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected"),
    [("train --se", {"--seed", "--seeds", "--set"}), ("train mi", {"mine.yaml "}), ("publ", {""})],
)
def test_argcomplete_completes_commands_options_choices_and_files(
    words: str, expected: set[str], tmp_path: Path
) -> None:
    pytest.importorskip("argcomplete")
    (tmp_path / "mine.yaml").touch()
    line = f"rkhs {words}"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_STDOUT_FILENAME": "completions"}
    place = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9"}
    command = [sys.executable, "-m", "rkhs_ros.app.cli"]
    ended = subprocess.run(command, cwd=tmp_path, env={**os.environ, **asked, **place}, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    assert set((tmp_path / "completions").read_text().split("\n")) == expected


def checked(rkhs: Run, *arguments: object) -> dict[str, str]:
    """Return the values by name, and the last line as "last"."""
    result = rkhs("check", *arguments)
    assert (result.code, result.err) == (0, "")
    *lines, last = result.out.splitlines()
    return {"last": last} | {name: value.strip() for name, _, value in (line.partition("  ") for line in lines)}


def test_a_wrapped_angle_is_found_and_a_file_gets_its_settings(rkhs: Run) -> None:
    wrapped = "environment.options.angle=wrap"
    assert checked(rkhs, "rkhs/Pendulum-v0", "--set", wrapped)["angles"].startswith("0 ")
    values = checked(rkhs, CONFIG.with_name("pendulum_nac.yaml"), "--set", wrapped)
    assert values["angles"].endswith("in radians")
    assert "'inputs.angles=[0]'" in values["last"]
    assert values["last"].startswith("try: --set ")


@pytest.mark.parametrize(
    "fixed",
    [
        ("kernel={form: monomials, degree: 2}",),
        ("algorithm={name: enac, grid: [-4, 4, 3, -9, 9, 4]}", "kernel.bandwidth=1.0"),
    ],
)
def test_inputs_that_training_keeps_are_not_searched(rkhs: Run, fixed: tuple[str, ...]) -> None:
    wrapped = "environment.options.angle=wrap"
    values = checked(rkhs, CONFIG.with_name("pendulum_nac.yaml"), "--set", wrapped, *fixed)
    not_tested = "not tested, since kernel.form, the grid or kernel.bandwidth depends on the inputs"
    assert values["angles"] == values["history"] == not_tested
    assert "inputs" not in values["last"]


@pytest.mark.parametrize(
    ("history", "expected"), [(1, "predicts better"), (2, "longer"), (4, "more than 3 is not tested")]
)
def test_a_history_is_compared_with_the_given_one(history: int, expected: str) -> None:
    rng = np.random.default_rng(0)
    observed = np.zeros((4, 101, 1))
    actions = rng.uniform(-1.0, 1.0, (4, 100, 1))
    velocity = np.zeros((4, 1))
    for t in range(100):  # only the position is observed
        velocity = 0.9 * velocity + 0.3 * actions[:, t] - 0.2 * observed[:, t]
        observed[:, t + 1] = observed[:, t] + velocity
    episodes = Episodes.without_ends(observed[:, :-1], actions, observed[:, 1:, 0], np.ones((4, 100), dtype=bool))
    training = model_free(inputs=Inputs(history=history), action_repeat=1)
    checked = TaskCheck.of(episodes, training, Spaces((1,), -np.ones(1), np.ones(1)))
    assert expected in dict(checked.lines(None))["history"]


@pytest.mark.parametrize(("frequency", "fast"), [(0.088, False), (0.105, True)])  # changes of 0.55 and 0.65
def test_a_task_whose_state_changes_too_fast_is_named(frequency: float, fast: bool) -> None:
    phase = 2.0 * np.pi * frequency * np.arange(400)
    observed = np.stack([np.sin(phase), np.cos(phase)], axis=1)[None]
    rng, ones = np.random.default_rng(0), np.ones((1, 400), dtype=bool)
    actions, rewards = rng.uniform(-1.0, 1.0, (1, 400, 1)), observed[..., 0]
    episodes = Episodes.without_ends(observed, actions, rewards, ones)
    checked = TaskCheck.of(episodes, model_free(), Spaces((2,), -np.ones(1), np.ones(1)))
    assert ("change per decision: run the task at a higher control rate" in checked.problems()) == fast


@pytest.mark.slow
def test_a_policy_is_exported_as_onnx(rkhs: Run) -> None:
    pytest.importorskip("onnxruntime")
    config, small = CONFIG.with_name("pendulum_nac.yaml"), ("iterations=2", "episodes_per_iteration=3", "horizon=15")
    done = rkhs("train", config, "--runner", "inline", "--quiet", "--out", "run", "--set", *small)
    assert done.code == 0, done.err
    done = rkhs("export", "run", "policy.onnx")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("Exported the policy: policy.onnx\nChecked on 1000 random observations: relative error ")
    assert Path("policy.onnx").is_file()


def test_export_needs_one_known_format(rkhs: Run) -> None:
    assert_refused(rkhs("export", "run"), "export: expected a file to write or --lerobot DIR, got neither")
    both = rkhs("export", "run", "a.onnx", "--lerobot", "b")
    assert_refused(both, "export: expected a file to write or --lerobot DIR, got file and lerobot")
    assert_refused(rkhs("export", "run", "a.pt"), "a.pt: expected a file that ends in .onnx or .html, got .pt")
    unused = rkhs("export", "run", "a.html", "--fps", 5)
    assert_refused(unused, "--fps: expected none without --lerobot, got 5")
    assert_refused(rkhs("export", "run", "new/a.onnx"), "run: expected an existing file or folder, got none")
    assert not Path("new").exists()
