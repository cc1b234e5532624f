"""Status reports of nodes."""

import csv
import socket
from collections.abc import Callable
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from rkhs_interfaces.msg import Action, LearningProgress
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from test.ros.conftest import ROOT, Probe, Process

Start = Callable[..., Process]
PENDULUM = ROOT / "config" / "pendulum_nac.yaml"
KEYS = {"serving version", "batch", "step", "steps per second", "refusals", "ignored", "last refusal"}


class Hearing:
    """The newest report of each node."""

    def __init__(self, probe: Probe) -> None:
        self.reports: dict[str, DiagnosticStatus] = {}
        probe.create_subscription(DiagnosticArray, "/diagnostics", self._report, DIAGNOSTICS_QOS)

    def value(self, name: str, key: str) -> str:
        return next((v.value for v in self.reports[name].values if v.key == key), "") if name in self.reports else ""

    def _report(self, message: DiagnosticArray) -> None:
        self.reports |= {status.name: status for status in message.status}


def test_every_node_reports_its_status_and_refusals_and_the_learner_its_curve(
    start: Start, probe: Probe, tmp_path: Path
) -> None:
    start("rkhs", "train", PENDULUM, "--quiet", "--iterations", 10_000, "--out", tmp_path / "out")
    hearing = Hearing(probe)
    progress: list[LearningProgress] = []
    probe.create_subscription(LearningProgress, "progress", progress.append, LATCHED_QOS)
    nodes = ("/simulator", "/policy", "/learner")
    probe.until(lambda: set(nodes) <= set(hearing.reports))
    status = start("rkhs", "status")
    probe.until(lambda: all(float(hearing.value(name, "steps per second")) > 0 for name in nodes))
    for name in nodes:
        report = hearing.reports[name]
        assert {value.key for value in report.values} == KEYS - ({"step"} if name == "/learner" else set())
        assert report.level == DiagnosticStatus.OK
        assert report.hardware_id == socket.gethostname()

    def told() -> bool:
        probe.say("action", Action(batch=3))  # again and again, since others may be refused after it
        refusal = hearing.value("/simulator", "last refusal")
        return refusal.startswith("action: expected batch ") and "batch 3, step 0" in refusal

    probe.until(told)
    probe.until(lambda: progress[-1].iteration > 1)
    last, rows = progress[-1], list(csv.DictReader((tmp_path / "out" / "curve.csv").open()))
    assert {name: str(getattr(last, name)) for name in rows[0]} == rows[last.iteration - 1]
    returns = [row["exploration_return"] for row in rows[: last.iteration]]
    assert [str(each) for each in last.last_exploration_returns] == returns
    code, out, err = status.finish()
    assert (code, err) == (0, "")
    assert "/learner" in out
