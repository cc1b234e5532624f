"""Runs from Python with a folder, which equals the folder of the command line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import rkhs_ros
from rkhs_ros.runs.curve import Curve
from test.unit.conftest import Result, assert_refused

SHORT: dict[str, Any] = {
    "iterations": 3,
    "episodes_per_iteration": 2,
    "evaluation_episodes": 2,
    "horizon": 8,
    "seed": 4,
    "model": rkhs_ros.ModelBased(updates=2, rollouts=5),
    "progress": False,
}
PLAIN = ("iterations", "episodes_per_iteration", "evaluation_episodes", "horizon", "seed")
CHANGES = [*(f"{name}={SHORT[name]}" for name in PLAIN), "model.updates=2", "model.rollouts=5"]
WITH_TIMES = {"curve.csv", "recording.mcap"}  # files that contain wall times


class Slide(gymnasium.Env[Any, Any]):
    """A point on a line, to be moved to 0."""

    observation_space = Box(-1.0, 1.0, (1,))
    action_space = Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-1.0, 1.0, 1)
        return self.place.astype(np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place = np.clip(self.place + 0.3 * action, -1.0, 1.0)
        return self.place.astype(np.float32), -float(self.place[0] ** 2), False, False, {}


def without_times(folder: Path) -> list[tuple[Any, ...]]:
    return [tuple(f"{each}" for each in row[:-1]) for row in Curve(folder / "curve.csv").rows()]


def test_a_run_writes_the_folder_of_the_command_line(tmp_path: Path, rkhs: Callable[..., Result]) -> None:
    ours, theirs = tmp_path / "python", tmp_path / "command"
    result = rkhs_ros.train("rkhs/Toy-v0", out=ours, **SHORT)
    train = ("train", "--env", "rkhs/Toy-v0", "--runner", "inline", "--quiet", "--out", theirs)
    assert rkhs(*train, "--set", *CHANGES).code == 0
    files = [{file.relative_to(run) for file in run.rglob("*") if file.is_file()} for run in (ours, theirs)]
    assert files[0] == files[1]
    same = [file for file in files[0] if file.name not in WITH_TIMES]
    assert {"config.yaml", "policy.npz", "best_policy.npz", "curve.png"} <= {file.name for file in same}
    for file in same:
        assert (ours / file).read_bytes() == (theirs / file).read_bytes(), file
    assert without_times(ours) == without_times(theirs)
    assert repr(list(result.rows)) == repr(Curve(ours / "curve.csv").rows())
    assert without_times(ours) == [tuple(f"{e}" for e in r[:-1]) for r in rkhs_ros.train("rkhs/Toy-v0", **SHORT).rows]


@pytest.mark.parametrize("source", ["rkhs/Toy-v0", Slide()], ids=["id", "instance"])
def test_a_run_that_a_callback_stops_resumes_bit_identically(source: Any, tmp_path: Path) -> None:
    whole = rkhs_ros.train(source, out=tmp_path / "whole", **SHORT)
    folder, seen = tmp_path / "stopped", list[int]()

    def stop_at_two(result: rkhs_ros.Result) -> bool:
        seen.append(result.iteration.number)
        assert len(Curve(folder / "curve.csv").rows()) == len(seen)
        return len(seen) < 2

    stopped = rkhs_ros.train(source, out=folder, callback=stop_at_two, **SHORT)
    assert seen == [1, 2] == stopped.curve["iteration"].tolist()
    assert rkhs_ros.load(folder / "policy.npz").gaussian.mean.weights.tolist()
    assert (folder / "curve.png").is_file()
    resumed = rkhs_ros.train(source, out=folder, resume=True, **SHORT)
    assert without_times(folder) == without_times(tmp_path / "whole")
    assert repr(list(resumed.rows)) == repr(Curve(folder / "curve.csv").rows())
    for name in ("policy.npz", "best_policy.npz"):
        assert (folder / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    best = [each.best_policy for each in (resumed, whole)]
    weights = [each.gaussian.mean.weights.tobytes() for each in best if each]
    assert len(weights) == 2
    assert len(set(weights)) == 1


def test_a_folder_is_not_overwritten_and_another_run_not_resumed(tmp_path: Path) -> None:
    run, other = tmp_path / "run", tmp_path / "other"
    rkhs_ros.train("rkhs/Toy-v0", out=run, resume=True, **SHORT)  # starts the run, since there is none
    before = (run / "curve.csv").read_bytes()
    with pytest.raises(ValueError, match=r"run: expected a new or empty folder, or resume=True to continue .* a run$"):
        rkhs_ros.train("rkhs/Toy-v0", out=run, **SHORT)
    with pytest.raises(ValueError, match="seed: expected 4 as at the start of the run, got 5"):
        rkhs_ros.train("rkhs/Toy-v0", out=run, resume=True, **{**SHORT, "seed": 5})
    with pytest.raises(ValueError, match=r"policy: expected none, or the initial policy of the run in .*, got another"):
        rkhs_ros.train("rkhs/Toy-v0", out=run, resume=True, policy=run / "policy.npz", **SHORT)
    assert (run / "curve.csv").read_bytes() == before
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="other: expected a new or empty folder"):
        rkhs_ros.train("rkhs/Toy-v0", out=other, resume=True, **SHORT)


def test_a_run_in_an_environment_of_other_dimensions_is_not_resumed(tmp_path: Path) -> None:
    class Wide(Slide):
        observation_space = Box(-1.0, 1.0, (2,))

    Wide.__name__ = Wide.__qualname__ = "Slide"
    rkhs_ros.train(Slide, out=tmp_path / "run", **SHORT)
    before = (tmp_path / "run" / "config.yaml").read_bytes()
    message = (
        r"run: environment: expected 1 inputs and 1 actions as at the start of the run, got 2 inputs and 1 actions$"
    )
    with pytest.raises(ValueError, match=message):
        rkhs_ros.train(Wide, out=tmp_path / "run", resume=True, **{**SHORT, "iterations": 4})
    assert (tmp_path / "run" / "config.yaml").read_bytes() == before


def test_a_generator_that_is_closed_before_its_first_iteration_closes_the_environment() -> None:
    closed = []

    class Hardware(Slide):
        def close(self) -> None:
            closed.append(self)

    rkhs_ros.learn(Hardware, horizon=5).close()
    assert closed


def test_a_class_is_named_by_commands_that_cannot_create_it(tmp_path: Path, rkhs: Callable[..., Result]) -> None:
    folder = tmp_path / "run"
    result = rkhs_ros.train(Slide, out=folder, **SHORT)
    assert rkhs("plot", folder).code == rkhs("replay", folder).code == 0
    evaluations = [rkhs_ros.evaluate(*each, episodes=3) for each in ((folder, Slide), (result.policy, Slide()))]
    assert len({each.discounted_returns.tobytes() for each in evaluations}) == 1
    assert evaluations[0].undiscounted_return < evaluations[0].discounted_return < 0.0
    with pytest.raises(ValueError, match=r"^policy: expected a policy, its file, or a run's folder, got int$"):
        rkhs_ros.evaluate(5, Slide)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^seed: expected a whole number in \[0, 2\^63\), got a$"):
        rkhs_ros.evaluate(folder, Slide, seed="a")  # type: ignore[arg-type]
    for words in (("evaluate", folder), ("train", "--resume", folder, "--runner", "inline")):
        result = rkhs(*words)
        assert_refused(result, "unknown environment 'Slide'")
        assert result.err.endswith("pass it to rkhs_ros.evaluate, or to rkhs_ros.train with resume=True\n")
