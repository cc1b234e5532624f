"""All settings are ROS parameters with a description, and with a range if they are bounded."""

from collections.abc import Callable
from pathlib import Path

import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter

from rkhs_ros.base.settings import entries
from rkhs_ros.learning.model_based.settings import NoModel
from rkhs_ros.learning.training_settings import Training
from test.ros.conftest import Probe, Process

OPTIONS = ["environment.options.angle", "environment.id", "environment.num_envs"]
NAMES = [entry.name for entry in entries(Training(model=NoModel())) if entry.value != ()]  # ROS has no empty lists


@pytest.fixture
def learner(start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path, probe: Probe) -> Probe:
    file = parameters("pendulum_nac", "algorithm.ridge=0.25", "seed=11")
    start("learner", "--ros-args", "--params-file", file, "-p", f"output:={tmp_path / 'out'}")
    for service in (DescribeParameters, GetParameters, SetParameters):
        name = {DescribeParameters: "describe", GetParameters: "get", SetParameters: "set"}[service]
        probe.add_service(f"learner/{name}_parameters", service)
    return probe


def test_every_setting_is_described_and_read_only(learner: Probe) -> None:
    answer = learner.ask("learner/describe_parameters", DescribeParameters.Request(names=NAMES))
    described = {descriptor.name: descriptor for descriptor in answer.descriptors}
    assert set(described) == set(NAMES)
    assert all(d.description and d.read_only and d.type != ParameterType.PARAMETER_NOT_SET for d in described.values())
    (discount,) = described["discount"].floating_point_range
    assert (discount.from_value, discount.to_value) == (0.0, 1.0)
    (iterations,) = described["iterations"].integer_range
    assert iterations.from_value == 1
    assert "trajectory" in described["algorithm.critic"].additional_constraints
    assert described["action_repeat"].additional_constraints == "1 to 1000, or one of auto"


def test_environment_options_are_described_and_read_only(
    start: Callable[..., Process], parameters: Callable[..., Path], probe: Probe
) -> None:
    file = parameters("pendulum_wrap_few_nac")
    start("simulator", "--ros-args", "--params-file", file)
    probe.add_service("simulator/describe_parameters", DescribeParameters)
    probe.add_service("simulator/set_parameters", SetParameters)
    answer = probe.ask("simulator/describe_parameters", DescribeParameters.Request(names=OPTIONS))
    assert [d.name for d in answer.descriptors] == OPTIONS
    assert all(d.description and d.read_only for d in answer.descriptors)
    change = Parameter(OPTIONS[0], value="clip").to_parameter_msg()
    (result,) = probe.ask("simulator/set_parameters", SetParameters.Request(parameters=[change])).results
    assert not result.successful


@pytest.mark.parametrize("name", ["simulator", "policy", "simulated_robot"])
def test_no_parameter_can_be_set_while_a_node_runs(start: Callable[..., Process], probe: Probe, name: str) -> None:
    given = {"simulator": ("-p", "environment.id:=rkhs/Toy-v0")}
    start(name, "--ros-args", *given.get(name, ()))
    for kind, service in (("list", ListParameters), ("describe", DescribeParameters), ("set", SetParameters)):
        probe.add_service(f"{name}/{kind}_parameters", service)
    names = probe.ask(f"{name}/list_parameters", ListParameters.Request()).result.names
    assert "use_sim_time" in names
    described = probe.ask(f"{name}/describe_parameters", DescribeParameters.Request(names=names)).descriptors
    assert [each.name for each in described if not each.read_only] == []
    change = Parameter("use_sim_time", value=True).to_parameter_msg()
    (result,) = probe.ask(f"{name}/set_parameters", SetParameters.Request(parameters=[change])).results
    assert not result.successful


def test_settings_have_the_values_of_the_file_and_are_read_only(learner: Probe) -> None:
    answer = learner.ask("learner/get_parameters", GetParameters.Request(names=["algorithm.ridge", "seed"]))
    assert [answer.values[0].double_value, answer.values[1].integer_value] == [0.25, 11]
    change = Parameter("algorithm.ridge", value=0.5).to_parameter_msg()
    (result,) = learner.ask("learner/set_parameters", SetParameters.Request(parameters=[change])).results
    assert not result.successful
