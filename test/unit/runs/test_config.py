from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st

import rkhs_ros
from rkhs_ros.app.robots import check_robot
from rkhs_ros.base.yaml_text import dumped, is_for
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.step_rules import KLStep
from rkhs_ros.learning.training_settings import ModelBased, Training
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment, config_for, load_config
from rkhs_ros.runs.defaults import settings_for
from rkhs_ros.runs.report import resolved

CONFIGS = sorted((Path(__file__).parents[3] / "config").glob("*.yaml"))
MINIMAL = "simulator: {ros__parameters: {environment: {id: rkhs/Toy-v0}}}\n"


@pytest.fixture
def write(tmp_path: Path) -> Any:
    def make(text: str) -> Path:
        path = tmp_path / "my_run.yaml"
        path.write_text(text)
        return path

    return make


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_configuration_survives_a_round_trip(path: Path, write: Any) -> None:
    config = load_config(path)
    assert config.training.name == path.stem
    assert load_config(write(resolved(config))) == config


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_task_of_every_configuration_can_be_simulated(path: Path) -> None:
    environment = load_config(path).environment
    if "PR2" in environment.id or "pybullet_data" in path.read_text():
        pytest.importorskip("pybullet", reason="PyBullet is not installed")
    if environment.nodes:
        check_robot(load_config(path))
    else:
        Simulation(environment.id, environment.options)


def test_changes_replace_the_files_settings_and_nothing_else(write: Any) -> None:
    path = write(MINIMAL + "learner: {ros__parameters: {seed: 3, algorithm: {name: rkhs_nac, ridge: 0.5}}}\n")
    config = load_config(
        path, ["seed=4", "algorithm.step.rule=kl", "algorithm.step.size=2", "exploration_sd=[1, 2]", "environment.id=X"]
    )
    algorithm = RKHSNAC(ridge=0.5, step=KLStep(size=2.0))
    expected = Training(name="my_run", seed=4, exploration_sd=(1.0, 2.0), algorithm=algorithm)
    assert config == Config(Environment("X", {}), expected)
    assert load_config(path).training == replace(expected, seed=3, exploration_sd="range", algorithm=RKHSNAC(ridge=0.5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("seed", "--set: expected KEY=VALUE, got 'seed'"),
        ("sead=1", r"unknown key 'sead', did you mean 'seed'\?"),
        ("seed.x=1", "seed: expected"),
        ("environment.options=5", r"environment\.options: expected a section of keys, got 5"),
        ("kernel.bandwidth=mean", r"kernel\.bandwidth: unknown choice 'mean'"),
    ],
)
def test_an_invalid_change_is_rejected(write: Any, change: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_config(write(MINIMAL + "learner: {ros__parameters: {seed: 0}}\n"), [change])


def test_a_robot_has_no_settings_of_a_simulator() -> None:
    with pytest.raises(ValueError, match="expected no settings of a simulator for a robot"):
        load_config(CONFIGS[0].with_name("robot_pendulum.yaml"), ["environment.id=Pendulum-v1"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1", "expected a YAML file, got one that cannot be parsed"),
        ("", "expected sections 'simulator' and 'learner', got NoneType"),
        (MINIMAL.replace("Toy-v0", "Toy-v0, nodes: {robot: {}}"), r"environment\.nodes: expected none for a simulator"),
        ("simulator: {}", "simulator: expected ros__parameters"),
        ("learner: {ros__parameters: {}}", "environment: expected a key 'id'"),
        ("simulator: {ros__parameters: {enviroment: {}}}", "simulator: expected the key 'environment', got enviroment"),
        (MINIMAL + "learner: {ros__parameters: {seeds: 1}}", r"my_run\.yaml: unknown key 'seeds', did you mean"),
    ],
)
def test_an_invalid_configuration_file_is_rejected_in_one_line(write: Any, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        load_config(write(text))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("simulator", "learner"),
    [("/simulator", "/learner"), ("/**/simulator", "/**/learner"), ("/a/simulator", "learner")],
)
def test_the_sections_may_name_the_nodes_in_any_namespace(write: Any, simulator: str, learner: str) -> None:
    text = MINIMAL.replace("simulator", simulator) + learner + ": {ros__parameters: {seed: 5}}\n"
    assert load_config(write(text)) == load_config(write(MINIMAL), ["seed=5"])


def test_the_parameter_dump_of_a_node_is_a_configuration(write: Any) -> None:
    of_any = {"use_sim_time": False, "start_type_description_service": True}
    of_any |= {"qos_overrides": {"/parameter_events": {"publisher": {"depth": 1000}}}}
    config = load_config(CONFIGS[0])
    document = yaml.safe_load(resolved(config))
    learner = {**document["/**/learner"]["ros__parameters"], **of_any, "output": "", "quiet": True, "resume": False}
    simulator = {**document["/**/simulator"]["ros__parameters"], **of_any}
    policy = {**of_any, "policy_file": ""}
    nodes = {"/learner": learner, "/simulator": simulator, "/policy": policy}
    dump = {name: {"ros__parameters": parameters} for name, parameters in nodes.items()}
    assert load_config(write(dumped(dump))) == config


@pytest.mark.parametrize(
    ("section", "node", "expected"),
    [
        ("/a/simulator", "/a/simulator", True),
        ("/*/simulator", "/a/simulator", True),
        ("/*/simulator", "/a/b/simulator", False),
        ("/**/simulator", "/a/b/simulator", True),
        ("/**/simulator", "/a/learner", False),
        ("/**", "/a/learner", True),
    ],
)
def test_a_section_applies_to_matching_nodes(section: str, node: str, expected: bool) -> None:
    assert is_for(section, node) is expected


def training_on(horizon: int | None, *changes: str) -> Training:
    return config_for("rkhs/Toy-v0", horizon, changes).training


@given(st.integers(1, 10**6), st.integers(1, 10**6))
def test_the_discount_rises_with_the_horizon_and_stays_below_1(one: int, other: int) -> None:
    discounts = [settings_for(horizon=horizon)["discount"] for horizon in sorted((one, other))]
    assert 0.99 <= discounts[0] <= discounts[1] < 1.0


def test_the_horizon_of_the_settings_determines_the_discount() -> None:
    assert training_on(None).discount == 0.99
    assert training_on(1000).discount == 0.996
    assert (training_on(None, "horizon=1000").horizon, training_on(None, "horizon=1000").discount) == (1000, 0.996)
    assert training_on(1000, "horizon=100").discount == 0.99
    assert training_on(1000, "discount=0.9").discount == 0.9
    assert training_on(1000, "discount=0.9", "horizon=500").discount == 0.9


@pytest.mark.parametrize(("horizon", "form"), [(100, "gaussian_process"), (np.int64(1000), "none")])
def test_the_command_line_and_the_library_have_the_same_defaults(horizon: Any, form: str) -> None:
    small: dict[str, Any] = {"iterations": 1, "episodes_per_iteration": 1, "evaluate_every": 0}
    changes = [f"{name}={value}" for name, value in small.items()]
    training = training_on(None, f"horizon={horizon}", f"model.form={form}", *changes)
    model = "none" if form == "none" else ModelBased(updates=1, rollouts=2, centres=5)
    result = rkhs_ros.train("rkhs/Toy-v0", model=model, horizon=horizon, progress=False, **small)
    assert (result.policy.task.horizon, result.policy.task.discount) == (training.horizon, training.discount)
