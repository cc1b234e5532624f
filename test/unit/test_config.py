from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from rkhs_ros.base.settings import entries
from rkhs_ros.learning.rkhs_nac import RKHSNAC
from rkhs_ros.learning.steps import KLStep
from rkhs_ros.learning.training import Training
from rkhs_ros.runs.config import Config, Environment, load_config
from rkhs_ros.runs.report import resolved
from rkhs_ros.runs.simulation import Simulation

CONFIGS = sorted((Path(__file__).parents[2] / "config").glob("*.yaml"))
MINIMAL = "simulator: {ros__parameters: {environment: {id: rkhs/Toy-v0}}}\n"


@pytest.fixture
def write(tmp_path: Path) -> Any:
    def make(text: str) -> Path:
        path = tmp_path / "my_run.yaml"
        path.write_text(text)
        return path

    return make


def test_there_are_configurations() -> None:
    assert len(CONFIGS) >= 5


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_configuration_loads_and_comes_back_from_its_resolved_text(path: Path, write: Any) -> None:
    config = load_config(path)
    assert config.training.name == path.stem
    assert load_config(write(resolved(config))) == config


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_task_of_every_configuration_can_be_served(path: Path) -> None:
    environment = load_config(path).environment
    if "PR2" in environment.id:
        pytest.importorskip("pybullet", reason="PyBullet is not installed: make pr2")
    Simulation(environment.id, environment.options)


def test_the_resolved_text_holds_every_setting_of_the_learner(write: Any) -> None:
    config = load_config(write(MINIMAL))
    learner = yaml.safe_load(resolved(config))["learner"]["ros__parameters"]
    for name, value, _ in entries(config.training):
        found = learner
        for part in name.split("."):
            found = found[part]
        assert found == (list(value) if isinstance(value, tuple) else value)


def test_what_is_not_given_has_its_default(write: Any) -> None:
    assert load_config(write(MINIMAL)) == Config(Environment("rkhs/Toy-v0", {}), Training(name="my_run"))


def test_changes_replace_the_files_settings_and_nothing_else(write: Any) -> None:
    path = write(MINIMAL + "learner: {ros__parameters: {seed: 3, algorithm: {name: rkhs_nac, ridge: 0.5}}}\n")
    config = load_config(
        path, ["seed=4", "algorithm.step.rule=kl", "algorithm.step.cap=2", "exploration_sd=[1, 2]", "environment.id=X"]
    )
    algorithm = RKHSNAC(ridge=0.5, step=KLStep(cap=2.0))
    expected = Training(name="my_run", seed=4, exploration_sd=(1.0, 2.0), algorithm=algorithm)
    assert config == Config(Environment("X", {}), expected)
    assert load_config(path).training == replace(expected, seed=3, exploration_sd=(1.0,), algorithm=RKHSNAC(ridge=0.5))


def test_a_later_change_wins(write: Any) -> None:
    assert load_config(write(MINIMAL), ["seed=1", "seed=2"]).training.seed == 2


def test_options_reach_the_environment(write: Any) -> None:
    config = load_config(write(MINIMAL), ["environment.options.angle=wrap"])
    assert config.environment.options == {"angle": "wrap"}
    assert config.task.options == {"angle": "wrap"}
    assert load_config(write(resolved(config))) == config


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("seed", "--set: expected KEY=VALUE, got 'seed'"),
        ("=1", "--set: expected KEY=VALUE"),
        ("seed=[1", "--set: expected a value in YAML"),
        ("seed=x", "seed: expected a whole number, got 'x'"),
        ("sead=1", r"unknown key 'sead', did you mean 'seed'\?"),
        ("seed.x=1", "seed: expected"),
        ("environment=1", "environment: expected a section of keys, got 1"),
        ("environment.idd=a", r"unknown key 'environment\.idd', did you mean 'id'\?"),
        ("environment.id=5", r"environment\.id: expected text, got 5"),
        ("environment.options=5", r"environment\.options: expected a section of keys, got 5"),
        ("kernel.form=rbff", r"unknown kernel 'rbff', did you mean 'rbf'\?"),
        ("kernel.bandwidth=mean", r"kernel\.bandwidth: unknown choice 'mean'"),
        ("discount=1.5", r"discount: expected a number in \[0\.0, 1\.0\], got 1\.5"),
    ],
)
def test_a_bad_change_is_refused(write: Any, change: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_config(write(MINIMAL + "learner: {ros__parameters: {seed: 0}}\n"), [change])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1", "expected a YAML file, got one that cannot be parsed"),
        ("\x00", "expected a YAML file"),
        ("", "expected sections 'simulator' and 'learner', got NoneType"),
        ("- 1", "expected sections 'simulator' and 'learner', got list"),
        ("simulater: {}", r"unknown section 'simulater', did you mean 'simulator'\?"),
        ("simulator: {}", "simulator: expected ros__parameters"),
        ("simulator: {ros__parameters: 3}", "simulator: expected ros__parameters"),
        ("learner: {ros__parameters: {}}", "environment: expected a key 'id'"),
        ("simulator: {ros__parameters: {enviroment: {}}}", "simulator: expected the key 'environment', got enviroment"),
        (MINIMAL + "learner: {ros__parameters: {seeds: 1}}", r"unknown key 'seeds', did you mean 'seed'\?"),
    ],
)
def test_a_file_that_is_no_configuration_is_refused_in_one_line(write: Any, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        load_config(write(text))
    assert "\n" not in str(refusal.value)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_bytes(b"\xff\xfe\xff")
    with pytest.raises(ValueError, match=r"c\.yaml: expected a YAML file"):
        load_config(path)
