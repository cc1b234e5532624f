"""``rkhs train`` of a practice robot, with all its nodes, and what it leaves to go on from."""

import time
from collections.abc import Callable
from pathlib import Path

from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from test.ros.conftest import ROOT, Process, kill, nodes_of

Start = Callable[..., Process]
# Ten times as fast as the wall, so that what is late on a busy machine must be let pass.
QUICK = (
    "practice_robot.speed=10.0",
    "robot.period=0.01",
    "robot.action_deadline=1.0",
    "robot.misses_allowed=40",
    "robot.stale_after=1.0",
    "robot.learner_timeout=2.0",
    "robot.reset.home.speed=[30.0]",
    "gate.command_timeout=2.0",
    "gate.stale_after=1.0",
    "practice={form: none}",
    "algorithm={name: rkhs_nac}",
    "horizon=40",
    "episodes_per_iteration=2",
)


def test_it_learns_on_a_practice_robot_and_goes_on_where_it_was_left(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    config = ROOT / "config" / "robot_pendulum.yaml"
    command = ("rkhs", "train", config, "--quiet", "--out", folder, "--set", *QUICK, "iterations=1")
    code, out, err = start(*command).finish()
    assert (code, "error" in err) == (0, False), err
    assert out.startswith("Learnt motor_pendulum in 2 episodes")
    journal = folder / "checkpoints" / "episodes"
    first = {file.name: file.read_bytes() for file in journal.glob("*_steps_40.npz")}
    assert len(first) == 2
    assert load_config(folder / "config.yaml").environment.nodes["robot"]["period"] == 0.01
    code, _, err = start("rkhs", "train", "--quiet", "--resume", folder, "--iterations", 2).finish()
    assert code == 0, err
    assert [row.episodes for row in Curve(folder / "curve.csv").rows()] == [2, 4]
    assert {name: (journal / name).read_bytes() for name in first} == first


def test_a_gate_that_dies_ends_the_run(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    config = ROOT / "config" / "robot_pendulum.yaml"
    run = start("rkhs", "train", config, "--quiet", "--out", folder, "--set", *QUICK, "iterations=100")
    while not list(folder.glob("checkpoints/episodes/*.npz")) and run.popen.poll() is None:
        time.sleep(0.05)
    for pid in nodes_of(run, "gate"):
        kill(pid)
    code, _, err = run.finish()
    assert code == 1
    assert "error: the gate node was killed by signal 9; nothing may move without it" in err
