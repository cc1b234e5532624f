"""``rkhs train`` with a simulated robot and all its nodes, and resuming it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from std_srvs.srv import Trigger

from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.policies.storage import read_policy
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.runs.replay import replay
from test.ros.conftest import ROOT, Probe, Process
from test.ros.robot_bench import CONFIG, QUICK

pytestmark = pytest.mark.clock

Start = Callable[..., Process]
NODES = ("simulated_robot", "gate", "robot", "policy", "learner")


@pytest.mark.parametrize("launches", [False, True], ids=["by hand", "ros2 launch"])
def test_the_nodes_of_the_launch_file_learn_on_a_simulated_robot(start: Start, tmp_path: Path, launches: bool) -> None:
    if launches and shutil.which("ros2") is None:
        pytest.skip("ros2 launch comes with a native installation")
    folder, given = tmp_path / "run", tmp_path / "config.yaml"
    given.write_text(dumped(load_config(CONFIG, (*QUICK, "iterations=1")).parameters()))
    if launches:
        words = ("simulated:=true", f"config:={given}", f"output:={folder}")
        code, _, err = start("ros2", "launch", ROOT / "launch" / "train.launch.py", *words).finish()
    else:
        words = ("--ros-args", "--params-file", given)
        for name in NODES[:-1]:
            start(name, *words)
        code, _, err = start("learner", *words, "-p", f"output:={folder}").finish()
    assert code == 0, err
    assert [row.episodes for row in Curve(folder / "curve.csv").rows()] == [2]
    assert len(read_recording(folder).by_numbers()) == 2
    assert not (folder / "final_evaluation.txt").exists()  # which would move the robot


def test_a_run_on_a_simulated_robot_is_resumed_and_its_policy_evaluated(start: Start, tmp_path: Path) -> None:
    folder, repeat = tmp_path / "run", 3
    short = (*QUICK, "iterations=1", f"action_repeat={repeat}")
    code, out, err = start("rkhs", "train", CONFIG, "--quiet", "--out", folder, "--set", *short).finish()
    assert (code, "error" in err) == (0, False), err
    assert out.startswith("Trained on motor_pendulum for 2 episodes")
    first = read_recording(folder).by_numbers()
    assert len(list(replay(read_recording(folder)))) == 1
    code, _, err = start("rkhs", "train", "--quiet", "--resume", folder, "--iterations", 2).finish()
    assert code == 0, err
    assert [row.episodes for row in Curve(folder / "curve.csv").rows()] == [2, 4]
    again = read_recording(folder).by_numbers()
    assert (len(first), len(again)) == (2, 4)
    assert all(again[batch].attempt == each.attempt for batch, each in first.items())
    recorded = (folder / "recording.mcap").read_bytes()
    code, out, err = start("rkhs", "evaluate", folder, "--episodes", 2, "--discount", 1.0).finish()
    assert code == 0, err
    told, episodes = json.loads(out), load_episodes(folder / "evaluation.npz")[0]
    assert (told["environment"], told["episodes"]) == ("motor_pendulum", 2)
    np.testing.assert_allclose(told["mean"], episodes.returns(1.0).mean())
    policy, _, spaces = read_policy(folder / "policy.npz")
    assert spaces is not None
    assert spaces.observation_names == ("motor position (rad)", "motor velocity (rad/s)")
    decided = policy.mean(policy.inputs.features(episodes.observations[:, ::repeat].reshape(-1, 2)))
    mean = np.repeat(decided.reshape(2, -1, 1), repeat, axis=1)[:, : episodes.horizon]
    np.testing.assert_allclose(episodes.actions, mean)  # without exploration noise
    assert (folder / "recording.mcap").read_bytes() == recorded


def test_a_real_robot_waits_for_the_operator_to_arm_it(start: Start, tmp_path: Path, probe: Probe) -> None:
    document = load_config(CONFIG, (*QUICK, "iterations=1")).parameters()
    settings = tmp_path / "model.yaml"
    settings.write_text(dumped({"/**/simulated_robot": document.pop("/**/simulated_robot")}))
    document["/**/gate"]["ros__parameters"]["arms_itself"] = False
    config = tmp_path / "real.yaml"
    config.write_text(dumped(document))
    start("simulated_robot", "--ros-args", "--params-file", settings)  # for this run a robot as any other
    run = start("rkhs", "train", config, "--quiet", "--out", tmp_path / "run")
    waiting = (
        "the robot node is waiting: the gate is not armed; make sure that the robot may move, then run: rkhs robot arm"
    )
    assert any(waiting in line for line in run.popen.stderr)  # reads on until it says so
    probe.add_service("gate/arm", Trigger)
    probe.until(lambda: probe.ask_once("gate/arm", Trigger.Request(), "gate").success)  # not if joint states are late
    code, _, err = run.finish()
    assert code == 0, err


def test_episodes_with_a_protective_stop_are_discarded(start: Start, tmp_path: Path) -> None:
    weak = ("iterations=1", "simulated_robot.limits.torque=1.0")  # less than its gate lets through
    code, _, err = start("rkhs", "train", CONFIG, "--quiet", "--out", tmp_path / "run", "--set", *QUICK, *weak).finish()
    assert code == 1
    reason = "the simulated robot made a protective stop (torque: expected at most 1 N m, got "
    assert err.count(f"is discarded: {reason}") == 10  # each time the stop was ended, and the robot was reset
    last = "error: episode 1 was discarded 10 times in a row; the last reason: "
    assert err.splitlines()[-1].startswith(last + reason)
    assert not (tmp_path / "run" / "policy.npz").exists()
