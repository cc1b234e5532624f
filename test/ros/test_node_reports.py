"""The page of a run receives the reports of nodes and gate."""

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from rkhs_interfaces.msg import GateState, LearningProgress
from rkhs_ros.app.commands.view import reports_of
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS, TOPIC
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.watch import OF_OURS
from test.ros.conftest import Probe


def test_reports_of_a_run_arrive_until_they_are_closed(probe: Probe, domain: int, tmp_path: Path) -> None:
    assert reports_of(tmp_path)() is None  # no run over topics is active
    (tmp_path / "domain").write_text(f"{domain}\n")
    gate = probe.create_publisher(GateState, "gate/state", LATCHED_QOS)
    gate.publish(GateState(state="stopped", reason="too fast", commands=7, stops=1))
    progress = probe.create_publisher(LearningProgress, "progress", LATCHED_QOS)
    progress.publish(LearningProgress(run="mine"))
    nodes = probe.create_publisher(DiagnosticArray, TOPIC, DIAGNOSTICS_QOS)
    ours = [KeyValue(key=OF_OURS, value="0")]
    policy = DiagnosticStatus(name="/policy", level=DiagnosticStatus.OK, message="ok", values=ours)
    robot = DiagnosticStatus(name="/robot", level=DiagnosticStatus.ERROR, message="stuck: too fast", values=ours)
    driver = DiagnosticStatus(name="/a driver")
    reports = reports_of(tmp_path)()
    assert reports is not None

    def heard() -> bool:
        nodes.publish(DiagnosticArray(status=[policy, robot, driver]))
        return len(reports.nodes()) == 3 and bool(reports.gate())

    probe.until(heard)
    busy = ("/learner", "ok", "busy: it updates the policy")
    assert reports.nodes() == [busy, ("/policy", "ok", "ok"), ("/robot", "error", "stuck: too fast")]
    assert reports.gate().items() >= {"state": "stopped", "reason": "too fast", "commands": 7, "stops": 1}.items()
    reports.close()
    probe.until(lambda: nodes.get_subscription_count() == 0)
