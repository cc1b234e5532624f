import os
import signal

import pytest

from rkhs_ros.app.launcher import for_all, signals_held
from rkhs_ros.base.yaml_text import loaded

PARAMETERS = "/**/simulator: {ros__parameters: {environment: {id: x}}}\n/**/learner: {ros__parameters: {seed: 1}}\n"


@pytest.mark.parametrize(
    "path", ["a #b", "a: b", "{x}", " trailing \n line ", "1e5", "on", "é \U0001f600 \\ \"'", "*a"]
)
def test_paths_of_any_name_travel_in_the_parameter_file(path: str) -> None:
    document = loaded(for_all(PARAMETERS, 1, {"learner": {"output": path, "resume": True}}))
    assert document["/**/learner"]["ros__parameters"] == {
        "seed": 1,
        "environment": {"id": "x"},
        "output": path,
        "resume": True,
    }


def test_all_nodes_find_their_settings_and_the_learner_its_task() -> None:
    document = loaded(for_all(PARAMETERS, 2))
    assert document["/**/simulator"]["ros__parameters"] == {"environment": {"id": "x"}}
    assert document["/**/learner"]["ros__parameters"] == {"seed": 1, "environment": {"id": "x"}}
    assert document["/**/policy"]["ros__parameters"] == {"simulators": 2}


@pytest.mark.parametrize("path", ["\udcff", "a\0b"])
def test_a_path_that_no_parameter_can_be_is_refused(path: str) -> None:
    with pytest.raises(ValueError, match=r"learner\.output: expected .*text in UTF-8"):
        for_all(PARAMETERS, 1, {"learner": {"output": path}})


def test_an_interrupt_while_a_process_is_forked_is_not_lost() -> None:
    done = []

    def interrupted() -> None:
        with signals_held():
            os.kill(os.getpid(), signal.SIGINT)
            done.append("all the rest")

    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert done
    assert signal.getsignal(signal.SIGINT) is handler
