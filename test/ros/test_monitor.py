"""The page receives the reports of the nodes and sends commands to them, but never arms the gate."""

import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from rkhs_interfaces.msg import GateState
from rkhs_ros.app.commands.view import monitor_process
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS, TOPIC
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.watch.monitor_node import COMMANDS
from rkhs_ros.nodes.watch.operator_calls import SERVICES
from rkhs_ros.view.monitor import Monitor, NodeReport
from rkhs_ros.view.nodes_panel import EPISODES, STOP
from test.ros.conftest import Probe

pytestmark = pytest.mark.nightly


@pytest.fixture
def monitor(domain: int, tmp_path: Path) -> Iterator[Monitor]:
    """A monitor of a run in the test's domain, which its folder stores."""
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "domain").write_text(f"{domain}\n")
    listening = Monitor(lambda: monitor_process(tmp_path))
    yield listening
    listening.stop_listening()


class Peers:
    """Gate and robot node of a run in the test's process; they store the requests.

    Attributes:
        asked: the services that were called, in order.
        held: futures that delay an answer, by service.
    """

    def __init__(self, probe: Probe) -> None:
        self.asked: list[str] = []
        self.held: dict[str, Future] = {}
        nodes = {name: probe.add_node(name) for name in ("gate", "robot")}
        for name, kind, _ in SERVICES.values():
            nodes[name.partition("/")[0]].create_service(kind, name, partial(self.answer, name))
        self._gate = probe.create_publisher(GateState, "gate/state", LATCHED_QOS)
        self._diagnostics = probe.create_publisher(DiagnosticArray, TOPIC, DIAGNOSTICS_QOS)
        self._gate.publish(GateState(state="stopped", reason="too fast", commands=7, clamps=3, refusals=2, stops=1))

    async def answer(
        self, name: str, request: object, response: Trigger.Response | SetBool.Response
    ) -> Trigger.Response | SetBool.Response:
        self.asked.append(name)
        assert not isinstance(request, SetBool.Request) or request.data
        if name in self.held:
            await self.held[name]
        response.success, response.message = name != "robot/veto", "there is none" if name == "robot/veto" else ""
        return response

    def report(self) -> None:
        well = DiagnosticStatus(name="/policy", level=DiagnosticStatus.OK, message="ok")
        ill = DiagnosticStatus(name="/gate", level=DiagnosticStatus.ERROR, message="stuck: too fast")
        self._diagnostics.publish(DiagnosticArray(status=[well, ill]))


def test_reports_arrive_and_only_safe_commands_are_sent(monitor: Monitor, probe: Probe) -> None:
    peers = Peers(probe)

    def heard() -> bool:
        peers.report()
        return monitor.listen().gate is not None and len(monitor.listen().nodes) == 2

    probe.until(heard)
    report = monitor.listen()
    assert report.gate == {
        "state": "stopped", "reason": "too fast", "commands": 7, "clamps": 3, "refusals": 2, "stops": 1,
    }  # fmt: skip
    assert report.nodes == (NodeReport("/gate", "error", "stuck: too fast"), NodeReport("/policy", "ok", "ok"))
    for word in ("arm", "gate/arm", "ARM", "\0", "arm\nstop\narm"):
        monitor.send(word)
    probe.until(lambda: peers.asked == ["gate/stop"])
    for number, word in enumerate(("pause", "start", "veto")):
        monitor.send(word)
        probe.until(lambda expected=number + 2: len(peers.asked) == expected)
    probe.until(lambda: monitor.listen().answer == "veto: refused (there is none)")
    assert peers.asked == ["gate/stop", "robot/pause", "robot/start", "robot/veto"]
    clients = dict(probe.get_client_names_and_types_by_node("monitor", "/"))
    assert "/gate/stop" in clients
    assert "/gate/arm" not in clients


def test_an_answer_to_an_older_command_is_not_shown(monitor: Monitor, probe: Probe) -> None:
    peers = Peers(probe)
    peers.held["gate/stop"] = Future()
    probe.until(lambda: bool(monitor.listen() and monitor._process))
    monitor.send("stop")
    probe.until(lambda: "gate/stop" in peers.asked)
    monitor.send("pause")
    probe.until(lambda: monitor.listen().answer == "pause: done")
    peers.held["gate/stop"].set_result(None)
    probe.settle(1.0)
    assert monitor.listen().answer == "pause: done"


def test_commands_sent_before_discovery_arrive_in_order(monitor: Monitor, probe: Probe) -> None:
    probe.until(lambda: bool(monitor.listen() and monitor._process))
    for word in ("stop", "pause", "start"):
        monitor.send(word)
    probe.until(lambda: monitor.listen().answer == "start: requested")
    peers = Peers(probe)
    probe.until(lambda: monitor.listen().answer == "start: done")
    assert peers.asked.index("robot/pause") < peers.asked.index("robot/start")
    assert peers.asked.count("robot/start") == 1
    assert "gate/stop" in peers.asked


def test_a_silent_node_is_reported(monitor: Monitor, probe: Probe) -> None:
    peers = Peers(probe)

    def heard() -> bool:
        peers.report()
        return len(monitor.listen().nodes) == 2

    probe.until(heard)
    probe.until(lambda: {node.level for node in monitor.listen().nodes} == {"silent"})


def test_the_buttons_are_all_commands_except_arming() -> None:
    assert {STOP, *EPISODES.values()} == set(COMMANDS) == set(SERVICES) - {"arm"}


def test_the_process_ends_with_the_page(monitor: Monitor, probe: Probe) -> None:
    probe.until(lambda: monitor.listen().nodes is not None and "monitor" in probe.get_node_names())
    process = monitor._process
    assert process is not None
    monitor.stop_listening()
    assert process.poll() is not None


def test_there_is_no_monitor_of_a_finished_run_or_without_ros(tmp_path: Path) -> None:
    assert monitor_process(tmp_path) is None
    code = (
        "import sys; sys.modules['rclpy'] = None; from pathlib import Path; import rkhs_ros.app.commands.view as v; "
        "import rkhs_ros.view.serving; assert v.monitor_process(Path(sys.argv[1])) is None"
    )
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "domain").write_text("1\n")
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)
