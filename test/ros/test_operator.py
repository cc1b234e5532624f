"""``rkhs robot`` with nodes that answer late, never, or have just been discovered."""

from collections.abc import Callable

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from rkhs_ros.nodes.watch.operator_calls import REPEATED, SERVICES
from test.ros.conftest import Probe, Process

Start = Callable[..., Process]
Response = Trigger.Response | SetBool.Response


class Server:
    """A node with the service of a word, in the test's process, that may keep its first answer to itself.

    Attributes:
        asked: how often the service was called.
        first: is awaited before the first answer.
    """

    def __init__(self, probe: Probe, word: str, *, parameters: bool = True) -> None:
        self.asked = 0
        self.first = Future()
        service, kind, _ = SERVICES[word]
        node = probe.add_node(service.partition("/")[0], start_parameter_services=parameters)
        node.create_service(kind, service, self._answer, callback_group=ReentrantCallbackGroup())

    async def _answer(self, request: object, response: Response) -> Response:
        self.asked += 1
        if self.asked == 1:
            await self.first
        response.success = True
        return response


@pytest.mark.parametrize("word", REPEATED)
def test_stop_and_pause_are_repeated_until_answered(start: Start, probe: Probe, word: str) -> None:
    server, process = Server(probe, word), start("rkhs", "robot", word)
    probe.until(lambda: process.popen.poll() is not None)
    assert process.finish() == (0, f"{word}: done\n", "")
    assert server.asked > 1


@pytest.mark.parametrize("word", [word for word in SERVICES if word not in REPEATED])
def test_other_commands_are_sent_once(start: Start, probe: Probe, word: str) -> None:
    server, process = Server(probe, word), start("rkhs", "robot", word)
    probe.until(lambda: server.asked > 0)
    probe.settle(2.0)
    server.first.set_result(None)
    probe.until(lambda: process.popen.poll() is not None)
    assert process.finish() == (0, f"{word}: done\n", "")
    assert server.asked == 1


def test_arm_is_not_sent_to_a_node_that_has_not_answered(start: Start, probe: Probe) -> None:
    server, process = Server(probe, "arm", parameters=False), start("rkhs", "robot", "arm")
    probe.until(lambda: process.popen.poll() is not None)
    code, _, err = process.finish()
    assert (code, len(err.splitlines()), server.asked) == (1, 1, 0)
    assert "gate/arm: the node is not running" in err
