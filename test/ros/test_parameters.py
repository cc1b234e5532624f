"""All settings are ROS parameters with a description, and with a range if they are bounded."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter

from rkhs_ros.base.settings import entries
from rkhs_ros.learning.training_settings import NoModel, Training
from test.ros.conftest import Probe, Process

NAMES = [entry.name for entry in entries(Training(model=NoModel())) if entry.value != ()]  # ROS has no empty lists


def test_every_setting_is_described_and_read_only_with_the_value_of_the_file(
    start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path, probe: Probe
) -> None:
    file = parameters("pendulum_nac", "algorithm.ridge=0.25", "seed=11")
    start("learner", "--ros-args", "--params-file", file, "-p", f"output:={tmp_path / 'out'}")
    kinds = {"describe": DescribeParameters, "get": GetParameters, "set": SetParameters}

    def ask(word: str, **fields: Any) -> Any:
        probe.add_service(f"learner/{word}_parameters", kinds[word])
        return probe.ask(f"learner/{word}_parameters", kinds[word].Request(**fields))

    described = {each.name: each for each in ask("describe", names=NAMES).descriptors}
    assert set(described) == set(NAMES)
    assert all(d.description and d.read_only and d.type != ParameterType.PARAMETER_NOT_SET for d in described.values())
    (discount,) = described["discount"].floating_point_range
    assert (discount.from_value, discount.to_value) == (0.0, 1.0)
    (iterations,) = described["iterations"].integer_range
    assert iterations.from_value == 1
    assert "trajectory" in described["algorithm.critic"].additional_constraints
    assert described["action_repeat"].additional_constraints == "1 to 1000, or one of auto"
    ridge, seed = ask("get", names=["algorithm.ridge", "seed"]).values
    assert (ridge.double_value, seed.integer_value) == (0.25, 11)
    change = Parameter("algorithm.ridge", value=0.5).to_parameter_msg()
    assert not ask("set", parameters=[change]).results[0].successful
