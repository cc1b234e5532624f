import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, strategies as st

from rkhs_ros.base.yaml_text import MOST_BYTES, dumped, loaded, read_yaml, require_ros_value

texts = st.text(st.characters(codec="utf-8"), max_size=40) | st.from_regex(
    r"[-+.]?[0-9a-fxoeE_.:-]{1,8}", fullmatch=True
)
values = st.booleans() | st.integers(-(2**63) + 1, 2**63 - 1) | st.floats(allow_nan=False) | texts


@given(st.dictionaries(texts, values | st.lists(values), max_size=5))
def test_dumped_text_is_read_back_by_pyyaml_and_by_this_reader(tree: dict[str, Any]) -> None:
    text = dumped(tree)
    assert text.isascii()
    assert loaded(text) == tree == yaml.safe_load(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e5", 1e5),
        ("1:30", "1:30"),
        ("2020-01-01", "2020-01-01"),
        ("010", 8),
        ("0x1A", 26),
        ("y", True),
        ("off", False),
        ("'on'", "on"),
        ("{on: 1, 2: y}", {"on": 1, "2": True}),
    ],
)
def test_scalars_have_the_types_that_ros_gives_them(text: str, value: object) -> None:
    assert (type(loaded(text)), loaded(text)) == (type(value), value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{a: " * 20_000, "recursion depth"),
        ("x: &a 1\ny: *a", "line 1: anchors and aliases"),
        ("x: 1\n" * MOST_BYTES, f"at most {MOST_BYTES} characters, got more"),
        ("9" * 5000, "4300 digits"),
        ("!!python/object/apply:os.getcwd []", "python/object"),
        ("x: {y: 1,\n y: 2}", "line 2: a second key 'y'"),
        ("a: b: c", "mapping values are not allowed"),
    ],
)
@pytest.mark.timeout(5)
def test_deep_large_or_unsafe_text_raises_a_short_one_line_error(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        loaded(text)
    assert len(str(refusal.value)) < 300
    assert "\n" not in str(refusal.value)


def test_file_errors_name_the_file(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    unreadable = "expected a YAML file, got one that cannot be parsed ("
    for content, message in ((b"\xff\xfe", unreadable), (b"a: [", unreadable)):
        file.write_bytes(content)
        with pytest.raises(ValueError, match=re.escape(f"bad.yaml: {message}")):
            read_yaml(file)


@pytest.mark.parametrize("value", [2**63 - 1, "é\n", {"a": {"b": [0.5]}}])
def test_valid_ros_parameters_are_accepted(value: object) -> None:
    require_ros_value(value, "x")


@pytest.mark.parametrize(
    "value", [None, 2**63, math.nan, "a\0", "\udcff", [], [1, 0.5], {"a": {"b": None}}, {"a.b": 1}]
)
def test_invalid_ros_parameters_are_rejected_by_name(value: object) -> None:
    with pytest.raises(ValueError, match=r"^x(\.a\.b)?: expected"):
        require_ros_value(value, "x")


def test_shared_values_are_written_without_aliases() -> None:
    shared = {"id": "rkhs/Toy-v0"}
    text = dumped({"a": shared, "b": shared})
    assert "&" not in text
    assert loaded(text) == {"a": shared, "b": shared}
