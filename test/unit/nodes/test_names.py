"""Arguments of launch files."""

import pytest

from rkhs_ros.nodes.core.names import require_known_arguments

FILE = "train.launch.py"
KNOWN = dict.fromkeys(("config", "output", "namespace"))


@pytest.mark.parametrize(
    "words",
    [
        ["ros2", "launch", "rkhs_ros", FILE],
        ["ros2", "launch", "rkhs_ros", FILE, "config:=a.yaml", "output:=x:=y", "--noninteractive"],
        ["ros2", "launch", f"/somewhere/{FILE}", "namespace:=/a"],
        ["ros2", "launch", "robot", "robot.launch.py", "of_the_other:=1"],
        ["a", "program"],
    ],
)
def test_known_arguments_and_those_of_other_launch_files_are_accepted(words: list[str]) -> None:
    require_known_arguments(words, FILE, KNOWN)


def test_an_unknown_argument_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ValueError, match=r"unknown argument 'confg', did you mean 'config'\?"):
        require_known_arguments(["ros2", "launch", "rkhs_ros", FILE, "confg:=a.yaml"], FILE, KNOWN)
