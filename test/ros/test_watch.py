"""What people see of running nodes, and tell them: reports, the table of `rkhs status`, and `rkhs robot`."""

from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rich.console import Console

from rkhs_interfaces.msg import GateState, LearningProgress
from rkhs_ros.app.commands.view import reports_of
from rkhs_ros.app.launcher import reserved_domain
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS, TOPIC
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.watch import COLUMNS, LAST_REFUSAL, MODE, OF_OURS, SERVICES, heading, problems, table
from test.ros.conftest import Probe, Process


def test_reports_of_a_run_arrive_until_they_are_closed(probe: Probe, tmp_path: Path) -> None:
    assert reports_of(tmp_path)() is None  # no run over topics is active
    gate = probe.create_publisher(GateState, "gate/state", LATCHED_QOS)
    gate.publish(GateState(state="stopped", reason="too fast", commands=7, stops=1))
    progress = probe.create_publisher(LearningProgress, "progress", LATCHED_QOS)
    progress.publish(LearningProgress(run="mine"))
    nodes = probe.create_publisher(DiagnosticArray, TOPIC, DIAGNOSTICS_QOS)
    ours = [KeyValue(key=OF_OURS, value="0")]
    policy = DiagnosticStatus(name="/policy", level=DiagnosticStatus.OK, message="ok", values=ours)
    robot = DiagnosticStatus(name="/robot", level=DiagnosticStatus.ERROR, message="stuck: too fast", values=ours)
    driver = DiagnosticStatus(name="/a driver")
    with reserved_domain(tmp_path):
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


@pytest.mark.parametrize("text", ["[/red]", "a\x1b[31mb\x1b]0;title\x07", "two\nlines"])
def test_markup_and_escapes_are_printed_as_text(text: str) -> None:
    status = DiagnosticStatus(name=text, message=text, level=b"\x07")
    status.values = [KeyValue(key=key, value=text) for key in (*COLUMNS, LAST_REFUSAL)]
    out = StringIO()
    Console(file=out, width=20_000).print(table({text: status}), *problems({text: status}), sep="\n")
    shown = out.getvalue()
    assert not set(shown) & set("\x1b\x07")
    assert text[:6].split("\n")[0].split("\x1b")[0] in shown
    assert len(shown.splitlines()) == 3  # headers, the node, its reason


def test_problems_are_listed_below_the_table() -> None:
    why = "no simulator makes a step, and much more is to be said of this than any column has room for"
    values = dict.fromkeys(COLUMNS, "1000")
    source = "/joint_sates: no messages, no publishers; topics of sensor_msgs/msg/JointState: /joint_states"
    gate = {MODE: "stopped", "ignored": "0", LAST_REFUSAL: "a command", "source joints": source}
    known = {  # as gate and simulated robot report: some of the columns, and what they do
        "/gate": (b"\2", f"stopped: {why}", gate),
        "/simulated_robot": (b"\0", "ok", {"ignored": "0"}),
        "/robot": (b"\1", "waiting: for an operator", values | {MODE: "getting ready"}),
    }
    statuses = {
        name: DiagnosticStatus(
            name=name, level=level, message=message, values=[KeyValue(key=k, value=v) for k, v in about.items()]
        )
        for name, (level, message, about) in known.items()
    }
    Console(file=(out := StringIO()), width=80).print(table(statuses))
    assert [line.split()[:3] for line in out.getvalue().splitlines() if line.startswith("/")] == [
        ["/gate", "stopped", "0"],
        ["/robot", "waiting,", "getting"],
        ["/simulated_robot", "ok", "0"],
    ]
    assert [str(line) for line in problems(statuses)] == [
        f"/gate stopped: {why}",
        f"/gate joints: {source}",
        "/gate last refused or ignored a command",
        "/robot waiting: for an operator",
    ]


def test_the_heading_states_the_progress_of_the_run() -> None:
    progress = LearningProgress(run="mine", folder="/results/" + 30 * "long/" + "mine", iteration=3, iterations=40)
    progress.exploration_return, progress.seconds_left = 1.5, 12.0
    progress.last_evaluation_returns = [2.0, 2.5, float("nan")]  # the last iteration was not measured
    progress.model_return = float("nan")
    assert str(heading(progress)).splitlines() == [
        "mine: iteration 3 of 40, 0 episodes, 0 centres, about 12 s left",
        "return 1.5, evaluation 2.5",
        f"in {progress.folder}",
    ]


def test_a_command_calls_its_service_once_and_reports_the_answer(start: Callable[..., Process], probe: Probe) -> None:
    requests: list[str] = []
    nodes = {service.partition("/")[0] for service, *_ in SERVICES.values()}
    made = {name: probe.add_node(name) for name in nodes}

    def serve(word: str) -> None:
        def answer(request: object, response: object) -> object:
            requests.append(word)
            response.success, response.message = word != "veto", "as told"  # type: ignore[attr-defined]
            return response

        service, kind, _ = SERVICES[word]
        made[service.partition("/")[0]].create_service(kind, service, answer)

    for word in SERVICES:
        serve(word)
    processes = {word: start("rkhs", "robot", word) for word in SERVICES}
    probe.until(lambda: all(process.popen.poll() is not None for process in processes.values()))
    refused = (1, "", "error: veto was refused: as told\n")
    for word, process in processes.items():
        assert process.finish() == (refused if word == "veto" else (0, f"{word}: done (as told)\n", ""))
    assert sorted(requests) == sorted(SERVICES)


def test_a_command_without_a_node_fails_soon(start: Callable[..., Process]) -> None:
    code, _, err = start("rkhs", "robot", "stop").finish()
    assert (code, len(err.splitlines())) == (1, 1)
    assert "gate/stop: no node offers it; pass the run's folder, or set ROS_DOMAIN_ID" in err
