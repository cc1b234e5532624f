"""Tuning of a node's parameters: they are set again however the run ends, and the best ones load with ROS."""

import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from std_msgs.msg import Empty, Float64

from test.ros.conftest import ROOT, Probe, Process

BEFORE = {"gain": 3.0, "steps": 7}
TREE: dict[str, Any] = {
    "node": "tuned",
    "parameters": {"gain": {"minimum": 0.1, "maximum": 10.0, "scale": "log"}, "steps": {"minimum": 1, "maximum": 20}},
    "trial": {"seconds": 0.04, "topic": "go"},
    "sensors": {"load": {"topic": "load", "type": "std_msgs/msg/Float64", "fields": ["data"]}},
    "reward": {"topic": "score"},
    "timeout": 5.0,
}


class Tuned:
    """A node in this process: its score is the greater, the nearer its gain is to 1; it rejects gains below 0.2."""

    def __init__(self, probe: Probe) -> None:
        self.probe, self.trials, self.rejected = probe, 0, 0
        self.node = probe.add_node("tuned")
        within = ParameterDescriptor(floating_point_range=[FloatingPointRange(from_value=0.1, to_value=10.0)])
        self.node.declare_parameter("gain", BEFORE["gain"], within)
        self.node.declare_parameter("steps", BEFORE["steps"])
        self.node.declare_parameter("fixed", 1.0, ParameterDescriptor(read_only=True))
        self.node.declare_parameter("name", "x")
        self.node.add_on_set_parameters_callback(self._check)
        self.node.create_subscription(Empty, "go", self._count, 1)
        load, score = (self.node.create_publisher(Float64, topic, 1) for topic in ("load", "score"))
        self.node.create_timer(0.01, lambda: load.publish(Float64(data=float(self.trials % 2))))
        self.node.create_timer(0.01, lambda: score.publish(Float64(data=-abs(self.parameters["gain"] - 1.0))))

    @property
    def parameters(self) -> dict[str, Any]:
        return {name: self.node.get_parameter(name).value for name in BEFORE}

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        low = any(each.name == "gain" and each.value < 0.2 for each in parameters)
        self.rejected += low
        return SetParametersResult(successful=not low, reason="too low" if low else "")

    def _count(self, message: Empty) -> None:
        self.trials += 1


@pytest.fixture
def tuned(probe: Probe) -> Tuned:
    return Tuned(probe)


Tune = Callable[..., Process]


@pytest.fixture
def tune(start: Callable[..., Process], tmp_path: Path) -> Tune:
    """Start a tuning with changes of its file."""

    def begin(*arguments: object, **changes: Any) -> Process:
        file = tmp_path / "tune.yaml"
        file.write_text(yaml.safe_dump(TREE | changes))
        return start("rkhs", "tune-node", file, "--out", tmp_path / "out", *arguments)

    return begin


def ended(tuned: Tuned, run: Process) -> tuple[int, str, str]:
    tuned.probe.until(lambda: run.popen.poll() is not None)
    return run.finish()


def test_the_best_parameters_are_written_and_the_earlier_ones_set_again(
    tuned: Tuned, tune: Tune, tmp_path: Path
) -> None:
    code, out, _ = ended(tuned, tune("--trials", 13))
    assert (code, tuned.parameters) == (0, BEFORE)
    assert len((tmp_path / "out" / "trials.csv").read_text().splitlines()) == 1 + tuned.trials + tuned.rejected <= 14
    loaded = parameter_dict_from_yaml_file(str(tmp_path / "out" / "parameters.yaml"), target_nodes=["/tuned"])
    best = {name: Parameter.from_parameter_msg(each).value for name, each in loaded.items()}
    assert isinstance(best["steps"], int)
    assert 0.2 <= best["gain"] <= 10.0
    assert f"gain: {best['gain']:.6g} (before: 3)" in out
    assert not (tmp_path / "out" / "parameters_before.yaml").exists()


def test_a_finished_run_is_not_repeated_and_another_tuning_is_refused(tuned: Tuned, tune: Tune, tmp_path: Path) -> None:
    code, out, _ = ended(tuned, tune("--trials", 8))
    trials = tuned.trials + tuned.rejected
    again = ended(tuned, tune("--trials", 8))
    assert (code, again[:2], tuned.trials + tuned.rejected) == (0, (0, out), trials)
    narrow = TREE["parameters"] | {"gain": {"minimum": 0.5, "maximum": 1.0}}
    code, _, err = ended(tuned, tune(parameters=narrow))
    assert (code, tuned.trials + tuned.rejected) == (2, trials)
    assert "expected a new folder, or the run of the same tuning and seed, got the run of another one" in err
    with (tmp_path / "out" / "trials.csv").open("a") as file:
        file.write("\n")
    assert re.search(r"error: \S+trials.csv, line \d+: expected values of", ended(tuned, tune())[2])
    (tmp_path / "out" / "tuning.yaml").unlink()
    assert "one in use" in ended(tuned, tune())[2]


def test_the_best_parameters_stay_on_request(tuned: Tuned, tune: Tune, tmp_path: Path) -> None:
    code, *_ = ended(tuned, tune("--trials", 8, "--apply"))
    (best,) = yaml.safe_load((tmp_path / "out" / "parameters.yaml").read_text()).values()
    assert (code, tuned.parameters) == (0, best["ros__parameters"])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_run_with_the_earlier_parameters(tuned: Tuned, tune: Tune, number: int) -> None:
    run = tune()
    tuned.probe.until(lambda: tuned.trials > 1)
    os.kill(run.popen.pid, number)
    code, _, err = ended(tuned, run)
    assert (code, tuned.parameters) == (130, BEFORE)
    assert "Traceback" not in err


def test_after_a_kill_the_resumed_run_knows_the_earlier_parameters(tuned: Tuned, tune: Tune, tmp_path: Path) -> None:
    run = tune()
    tuned.probe.until(lambda: tuned.trials + tuned.rejected > 6 and tuned.parameters != BEFORE)
    run.popen.kill()
    ended(tuned, run)
    assert (tmp_path / "out" / "parameters_before.yaml").exists()
    before = tuned.trials + tuned.rejected
    code, *_ = ended(tuned, tune("--trials", 13))
    assert (code, tuned.parameters) == (0, BEFORE)
    assert tuned.trials + tuned.rejected <= 14  # the unfinished trial is repeated, and no other
    assert tuned.trials + tuned.rejected > before


def test_a_second_run_on_the_same_node_is_refused(tuned: Tuned, tune: Tune, tmp_path: Path) -> None:
    run = tune(trial={"seconds": 600.0, "topic": "go"})
    tuned.probe.until(lambda: tuned.trials == 1)
    code, _, err = ended(tuned, tune("--out", tmp_path / "other"))
    assert (code, run.popen.poll()) == (1, None)
    assert "error: /tuned: expected a node that no other run tunes, got one that another run tunes" in err
    os.kill(run.popen.pid, signal.SIGINT)
    ended(tuned, run)
    assert tuned.parameters == BEFORE


def test_there_are_no_best_parameters_if_all_are_rejected(tuned: Tuned, tune: Tune, tmp_path: Path) -> None:
    low = TREE["parameters"] | {"gain": {"minimum": 0.1, "maximum": 0.19}}
    code, _, err = ended(tuned, tune("--trials", 8, parameters=low))
    assert (code, tuned.parameters) == (1, BEFORE)
    assert "error: /tuned: expected a trial whose values it accepts, got none of 5" in err
    assert not (tmp_path / "out" / "parameters.yaml").exists()


def test_a_failure_ends_the_run_with_the_earlier_parameters(tuned: Tuned, tune: Tune) -> None:
    code, _, err = ended(tuned, tune(reward={"topic": "no_such_score"}))
    assert (code, tuned.parameters) == (1, BEFORE)
    assert "no message has arrived on no_such_score" in err


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"gian": {}}, "parameter 'gian' of /tuned: expected a declared one, got none"),
        ({"name": {}}, "parameter 'name' of /tuned: expected a double or an integer, got a string"),
        ({"fixed": {}}, "parameter 'fixed' of /tuned: expected one that can be set, got a read-only one"),
        ({"gain": {"maximum": 20.0}}, "parameter 'gain' of /tuned: expected a range within 0.1 to 10, got 0 to 20"),
    ],
)
def test_unsuitable_parameters_are_refused_before_the_first_trial(
    tuned: Tuned, tune: Tune, parameters: dict[str, Any], message: str
) -> None:
    code, _, err = ended(tuned, tune(parameters=parameters))
    assert (code, tuned.trials, tuned.parameters) == (2, 0, BEFORE)
    assert message in err


def test_a_missing_node_is_named(tuned: Tuned, tune: Tune) -> None:
    code, _, err = ended(tuned, tune(node="nobody", timeout=1.0))
    assert code == 1
    assert "error: the /nobody node did not answer within 1 s" in err


def test_the_example_is_tuned(start: Callable[..., Process], probe: Probe, tmp_path: Path) -> None:
    start("axis")
    tree = yaml.safe_load((ROOT / "config" / "tuning" / "axis.yaml").read_text())
    tree["trial"]["seconds"] = 0.1  # of 2
    (tmp_path / "axis.yaml").write_text(yaml.safe_dump(tree))
    run = start("rkhs", "tune-node", tmp_path / "axis.yaml", "--trials", 8, "--out", tmp_path / "out")
    code, out, err = run.finish()
    assert code == 0, err
    assert "ros2 param load /axis_controller" in out
