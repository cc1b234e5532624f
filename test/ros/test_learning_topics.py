"""Monitoring topics of a run, for early and late subscribers."""

import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from visualization_msgs.msg import Marker, MarkerArray

from rkhs_interfaces.msg import LearningEvent, LearningProgress, Policy
from rkhs_ros.app.inline import runner_of
from rkhs_ros.nodes.core.diagnostics import EVENTS_QOS, EVENTS_TOPIC
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.newest_topic import PERIOD_S
from rkhs_ros.policies.messages import policy_of
from rkhs_ros.policies.storage import policy_arrays, read_policy
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.control import ask, is_pausing
from rkhs_ros.runs.run import run_training
from rkhs_ros.sketches.sketch import SIZE
from test.ros.conftest import PATIENCE, ROOT, Probe, Process

Start = Callable[..., Process]
TOY = ROOT / "config" / "toy_nac.yaml"
ITERATIONS = 30


def hear(probe: Probe, kind: Any, topic: str, qos: QoSProfile = LATCHED_QOS) -> list[Any]:
    heard: list[Any] = []
    probe.create_subscription(kind, topic, heard.append, qos)
    return heard


def curve(folder: Path) -> list[dict[str, str]]:
    if not (folder / "curve.csv").exists():
        return []
    with (folder / "curve.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "out"


@pytest.fixture
def run(start: Start, folder: Path) -> Process:
    return start("rkhs", "train", TOY, "--quiet", "--iterations", ITERATIONS, "--out", folder)


@pytest.fixture
def lasting(start: Start, folder: Path) -> Process:
    """A run that does not end by itself while a test lasts."""
    return start("rkhs", "train", TOY, "--quiet", "--iterations", 5000, "--out", folder)


def test_progress_equals_the_curve_and_the_run_stays_bit_identical(run: Process, probe: Probe, folder: Path) -> None:
    heard = hear(probe, LearningProgress, "progress")
    more = [hear(probe, *what) for what in ((MarkerArray, "learning_markers"), (Policy, "policy_in_service"))]
    stamps: list[float] = []
    probe.create_subscription(
        LearningProgress, "progress", lambda message: stamps.append(time.monotonic()), LATCHED_QOS
    )
    probe.until(lambda: bool(heard) and heard[-1].iteration == ITERATIONS, 2 * PATIENCE)
    run.finish()
    rows, last = curve(folder), heard[-1]
    assert (last.run, last.folder, last.iterations) == ("toy_nac", str(folder), ITERATIONS)
    for message in heard:
        if message.iteration == 0:
            assert np.isnan(message.exploration_return)
            continue
        for name, text in rows[message.iteration - 1].items():
            assert str(getattr(message, name)) == text
    assert list(last.last_iterations) == list(range(1, ITERATIONS + 1))
    for name in ("exploration_return", "evaluation_return", "model_return"):
        assert [str(value) for value in getattr(last, f"last_{name}s")] == [row[name] for row in rows]
    assert last.seconds_left == 0.0
    first, end = (message.stamp.sec + 1e-9 * message.stamp.nanosec for message in (heard[0], last))
    assert len(heard) <= 3 + (end - first) / PERIOD_S  # the first and the last come at once
    assert all(more)
    config = load_config(TOY, [f"iterations={ITERATIONS}"])
    alone = run_training(config, runner_of(config.environment), folder.parent / "alone", quiet=True)
    assert (folder / "policy.npz").read_bytes() == (alone / "policy.npz").read_bytes()


@pytest.mark.nightly
def test_late_subscribers_receive_the_progress(lasting: Process, probe: Probe, folder: Path) -> None:
    probe.until(lambda: len(curve(folder)) > 1)
    ask(folder, "pause")
    probe.until(lambda: is_pausing(folder))
    done = len(curve(folder))
    progress, policies = hear(probe, LearningProgress, "progress"), hear(probe, Policy, "policy_in_service")
    markers = hear(probe, MarkerArray, "learning_markers")
    probe.until(lambda: bool(progress and progress[-1].iteration == done and policies and markers))
    best = read_policy(folder / "best_policy.npz").policy
    served = policy_of(policies[-1])
    assert len(served.mean.centres) == progress[-1].centres
    assert policy_arrays(served).keys() == policy_arrays(best).keys()
    check_markers(markers[-1].markers, progress[-1].centres)
    probe.settle(1.0)
    assert len(markers) == len(policies) == 1  # nothing new is there to be told


def check_markers(markers: list[Any], centres: int) -> None:
    assert {marker.header.frame_id for marker in markers} == {"map"}
    assert markers[0].action == Marker.DELETEALL
    drawn = markers[1:]
    assert len({(marker.ns, marker.id) for marker in drawn}) == len(drawn)
    points = np.array([(p.x, p.y, p.z) for marker in drawn for p in marker.points])
    assert (np.abs(points) <= SIZE / 2 + 1e-9).all()
    assert [len(marker.points) for marker in drawn if marker.ns == "centres"] == [centres]
    assert any(
        marker.type == Marker.LINE_STRIP and len(marker.points) > 5 for marker in drawn if marker.ns == "episodes"
    )
    words = [marker.text for marker in drawn if marker.ns == "axes"]
    assert [word.split(":")[0] for word in words] == ["position", "-", "move"]


@pytest.mark.nightly
def test_events_report_the_end_of_a_run(lasting: Process, probe: Probe, folder: Path) -> None:
    probe.until(lambda: len(curve(folder)) > 1)
    events = hear(probe, LearningEvent, EVENTS_TOPIC, EVENTS_QOS)
    ask(folder, "stop")
    probe.until(lambda: events != [] and (events[-1].node, events[-1].kind) == ("/learner", LearningEvent.STOP))
    assert lasting.popen.wait(PATIENCE) == 130
