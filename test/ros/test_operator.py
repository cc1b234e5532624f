"""``rkhs robot``: each command calls its service once, and reports the answer."""

from collections.abc import Callable

import pytest

from rkhs_ros.nodes.watch.operator_node import SERVICES
from test.ros.conftest import Probe, Process


@pytest.mark.parametrize("word", SERVICES)
def test_a_command_calls_its_service_once_and_reports_the_answer(
    start: Callable[..., Process], probe: Probe, word: str
) -> None:
    service, kind, _ = SERVICES[word]
    requests = []

    def answer(request: object, response: object) -> object:
        requests.append(request)
        response.success, response.message = word != "veto", "as told"  # type: ignore[attr-defined]
        return response

    probe.add_node(service.partition("/")[0]).create_service(kind, service, answer)
    process = start("rkhs", "robot", word)
    probe.until(lambda: process.popen.poll() is not None)
    refused = (1, "", "error: veto was refused: as told\n")
    assert process.finish() == (refused if word == "veto" else (0, f"{word}: done (as told)\n", ""))
    assert len(requests) == 1
