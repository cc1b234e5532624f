"""The description of a tuning: ranges, contexts and what is refused."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.robot.tuning import Parameter, tuning_from

TREE: dict[str, Any] = {
    "node": "controller",
    "parameters": {"p": {"minimum": 1.0, "maximum": 100.0, "scale": "log"}, "limit": {"minimum": -2, "maximum": 4}},
    "sensors": {"axis": {"joints": ["axis"], "fields": ["position"]}},
    "reward": {"topic": "score"},
}


def test_places_of_a_range_are_its_ends_and_its_middle() -> None:
    tuning = tuning_from(TREE)
    assert tuning.values([-1.0, -1.0]) == {"p": 1.0, "limit": -2.0}
    assert tuning.values([0.0, 0.0]) == {"p": pytest.approx(10.0), "limit": 1.0}
    assert tuning.values([7.0, 1.0]) == {"p": pytest.approx(100.0), "limit": 4.0}


@given(place=st.floats(-3.0, 3.0), scale=st.sampled_from(["linear", "log"]), low=st.floats(0.001, 1.0))
def test_a_value_is_within_its_range(place: float, scale: str, low: float) -> None:
    value = Parameter(low, 50.0, scale).value(place)
    assert low * (1 - 1e-12) <= value <= 50.0 * (1 + 1e-12)


def test_the_context_is_chosen_by_the_names_of_observed_values() -> None:
    tuning = tuning_from(TREE | {"context": ["axis position (rad)"]})
    assert tuning.context_columns() == [0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"node": ""}, "node: expected the name of a node, got none"),
        ({"parameters": {}}, "parameters: expected a section for each parameter, got {}"),
        ({"parameters": {"p": {"minimum": 2.0}}}, "parameters.p: minimum: expected less than the maximum, 1, got 2.0"),
        (
            {"parameters": {"p": {"scale": "log"}}},
            "parameters.p: minimum: expected more than 0 for scale: log, got 0.0",
        ),
        ({"parameters": {"p": {"minimun": 1}}}, "unknown key 'parameters.p.minimun', did you mean"),
        ({"sensors": {}}, "sensors: expected a section for each sensor"),
        ({"reward": {}}, "reward: expected a function or a topic, got neither"),
        ({"context": ["axis positon (rad)"]}, "context: unknown value 'axis positon .rad.', did you mean"),
        ({"trail": {}}, "unknown key 'trail', did you mean 'tri"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        tuning_from(TREE | change)
