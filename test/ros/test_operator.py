"""``rkhs robot``: each command calls its service once, and reports the answer."""

from collections.abc import Callable

from rkhs_ros.nodes.watch import SERVICES
from test.ros.conftest import Probe, Process


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
    assert "gate/stop: the node is not running; pass the run's folder, or set ROS_DOMAIN_ID" in err
