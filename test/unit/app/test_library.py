"""Training in one call, without files and without ROS."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rkhs_ros
from rkhs_ros.app.learn_settings import LearnSettings
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.runs.curve import Curve, columns
from test.unit.conftest import Result

SHORT: dict[str, Any] = {
    "iterations": 2,
    "episodes_per_iteration": 3,
    "evaluation_episodes": 2,
    "horizon": 10,
    "model": rkhs_ros.ModelBased(updates=2, rollouts=5),
}
ROOT = Path(__file__).parents[3]


class Own(rkhs_ros.RKHSNAC):
    """An algorithm that is not registered."""


def test_public_names_exist_and_match_those_for_type_checkers() -> None:
    source = (ROOT / "rkhs_ros" / "__init__.py").read_text()
    for name in rkhs_ros.__all__:
        assert callable(getattr(rkhs_ros, name))
        assert f" {name} as {name}" in source
    assert {cls.__name__ for cls in ALGORITHMS.values()} <= set(rkhs_ros.__all__)
    with pytest.raises(AttributeError, match=r"has no attribute 'trian', known: .*train"):
        rkhs_ros.trian  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("form", ["gaussian_process", "none"])
def test_defaults_do_not_depend_on_how_the_algorithm_is_chosen(form: str, rkhs: Callable[..., Result]) -> None:
    settings = {**SHORT, "model": form} if form == "none" else SHORT
    chosen = (None, "rkhs_nac", *([] if form == "none" else [rkhs_ros.RKHSNAC(), rkhs_ros.RKHSNAC(trace=0.95)]))
    curves = [rkhs_ros.train("rkhs/Toy-v0", each, progress=False, **settings).curve for each in chosen]
    changes = [f"{name}={value}" for name, value in SHORT.items() if name != "model"]
    changes += ["model.form=none"] if form == "none" else ["model.updates=2", "model.rollouts=5"]
    words = ("train", "--env", "rkhs/Toy-v0", "--runner", "inline", "--quiet", "--out", "run", "--set", *changes)
    assert rkhs(*words).code == 0
    of_command = columns(Curve(Path("run/curve.csv")).rows())
    for curve in (*curves[1:], of_command):
        for name in set(curve) - {"seconds"}:
            assert np.array_equal(curve[name], curves[0][name], equal_nan=True), name


def test_typed_keywords_match_the_accepted_settings() -> None:
    of_run = {each.name for each in fields(Training)} - {"algorithm", "timeout"}  # of nodes
    others = {"policy", "options", "num_envs", "out", "resume", "tensorboard"}
    assert set(LearnSettings.__annotations__) == of_run | others


def test_an_initial_policy_keeps_its_kernel(tmp_path: Path) -> None:
    first = rkhs_ros.train("rkhs/Toy-v0", progress=False, **SHORT).policy
    first.save(tmp_path / "p.npz")
    more = {**SHORT, "progress": False, "exploration_sd": (1e-6,)}
    for start in (first, tmp_path / "p.npz"):
        again = rkhs_ros.train("rkhs/Toy-v0", policy=start, **more)
        assert again.policy.gaussian.mean.kernel == first.gaussian.mean.kernel
    rkhs_ros.train("rkhs/Toy-v0", policy=first, out=tmp_path / "run", **{**SHORT, "progress": False})
    observed = np.full((1, 1), 3.0)
    assert rkhs_ros.load(tmp_path / "run" / "initial_policy.npz")(observed) == first(observed)  # with the action bounds
    (tmp_path / "run" / "initial_policy.npz").unlink()
    with pytest.raises(ValueError, match=r"initial_policy\.npz: expected the initial policy of the run, got none"):
        rkhs_ros.train(
            "rkhs/Toy-v0", out=tmp_path / "run", resume=True, **{**SHORT, "progress": False, "iterations": 3}
        )
    linear = rkhs_ros.train("rkhs/Toy-v0", kernel="linear", progress=False, **SHORT).policy
    with pytest.raises(ValueError, match="kernel: expected one without negative values"):
        rkhs_ros.train("rkhs/Toy-v0", rkhs_ros.RKHSPoWER(variance="learnt"), policy=linear, **SHORT)
    other = rkhs_ros.Inputs(history=2)
    with pytest.raises(ValueError, match="inputs: expected Inputs"):
        rkhs_ros.train("rkhs/Toy-v0", policy=first, inputs=other, **SHORT)
    with pytest.raises(
        ValueError, match="initial policy: expected one from 2 inputs to 1 actions like the task, got one from 1"
    ):
        rkhs_ros.train("rkhs/Pendulum-v0", policy=first, **SHORT)


@pytest.mark.parametrize(
    ("arguments", "settings", "message"),
    [
        (("Pendulum-v1",), {"callbck": print}, r"^unknown setting 'callbck', did you mean 'callback'\?$"),
        (("Pendulum-v1",), {"policy": 3}, r"^policy: expected a Policy or a policy file, got 3$"),
        (("Pendulum-v1", rkhs_ros.PoWER), {}, r"^algorithm: expected an instance such as RKHSNAC\(\), got <class"),
        (("Pendulum-v1",), {"callback": "stop"}, r"^callback: expected a function of a Result, got stop$"),
        (("Pendulum-v1",), {"centers": 9}, r"^unknown setting 'centers', did you mean RKHSNAC\(centres=\.\.\.\)\?$"),
        (("Pendulum-v1",), {"inputs": rkhs_ros.Inputs(degree=3)}, r"^inputs.degree: expected 0, since .*, got 3$"),
        (("Pendulum-v1",), {"horizon": 1_000_000, "evaluation_episodes": 11}, r"^horizon: expected at most 10000000"),
        (("Pendulum-v1", "enac"), {"inputs": rkhs_ros.Inputs(history=3)}, r"^algorithm.grid: expected at most 100000"),
        (
            ("Pendulum-v1",),
            {"inputs": rkhs_ros.Inputs(history=20), "kernel": rkhs_ros.KernelChoice("monomials", degree=20)},
            r"^inputs: expected at most 100000 numbers, got \d+$",
        ),
        ((lambda: 3,), {}, r"expected a function that returns an environment, got 3$"),
        (("Pendulum-v1", Own()), {"out": "run"}, r"^algorithm: expected one of `ALGORITHMS`, which out= can store"),
    ],
)
def test_bad_input_is_rejected_in_one_line(arguments: Any, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        rkhs_ros.train(*arguments, progress=False, **settings)
    assert "\n" not in str(refusal.value)


def test_learn_names_the_settings_that_only_train_has() -> None:
    with pytest.raises(ValueError, match=r"^unknown setting 'progress' of learn, which is one of train$"):
        rkhs_ros.learn("Pendulum-v1", progress=False)  # type: ignore[call-arg]
