"""ROS's reader and ours read the same values from a parameter file."""

from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from rkhs_ros.base.yaml_text import dumped, loaded
from rkhs_ros.nodes.core.parameters import given as parameters_of

RAW = "1e5 nan -inf on y No null ~ 0o7 0x1f 010 09 1_0 1:30 2020-01-01 = << {x} [ ' \" *a &a !a %a @a -"
MORE = "1. .5 1e+5 +3 -0 1.5e3 999999999999999999 .inf infinity Y TRUE oN 0b1 -0x1F 1e5x"
WORDS = [*RAW.split(), "", " a ", "a: b", "a #b", "? a", "a\nb", "\t"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "file.yaml"


def read_by_ros(file: Path, domain: int) -> dict[str, Any]:
    context = Context()
    rclpy.init(context=context, args=["--ros-args", "--params-file", str(file)], domain_id=domain)
    try:
        node = Node("reader", context=context, automatically_declare_parameters_from_overrides=True)
        try:
            return parameters_of(node)
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


def test_ros_reads_written_files(file: Path, domain: int) -> None:
    numbers = [0.1, -1e-300, 1e300, 5.0, -(2**63) + 1, 2**63 - 1]
    values = [*WORDS, *MORE.split(), *numbers, True, WORDS, [0.5, 1e22], [-1, 7], [True, False]]
    tree = {f"p{i}": value for i, value in enumerate(values)}
    file.write_text(dumped({"reader": {"ros__parameters": tree}}))
    assert read_by_ros(file, domain) == tree


def test_ros_reads_plain_scalars_as_this_reader_does(file: Path, domain: int) -> None:
    plain = [word for word in WORDS if word.isascii() and word.replace(":", "").replace("-", "").isalnum()]
    words = [
        word for word in (*plain, *MORE.split()) if word != "null"
    ]  # which ROS takes for text, and no setting may be
    lines = "".join(f"    p{i}: {word}\n" for i, word in enumerate(words))
    text = f"reader:\n  ros__parameters:\n{lines}"
    file.write_text(text)
    ours, theirs = loaded(text)["reader"]["ros__parameters"], read_by_ros(file, domain)
    said = {word: (repr(ours[f"p{i}"]), repr(theirs[f"p{i}"])) for i, word in enumerate(words)}
    assert {word: both for word, both in said.items() if both[0] != both[1]} == {}
