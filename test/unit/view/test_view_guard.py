"""The page accepts updates that its controls can send, and nothing else."""

import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.lock import locked
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.control import ASKED, PAUSE, RESUME, STOP
from rkhs_ros.runs.run import run_training

viser = pytest.importorskip("viser")

from rkhs_ros.view import page  # noqa: E402
from rkhs_ros.view.guard import is_allowed, is_fitting, is_local  # noqa: E402
from rkhs_ros.view.monitor import Monitor, NodeReport, Report  # noqa: E402
from rkhs_ros.view.nodes_panel import EPISODES  # noqa: E402
from rkhs_ros.view.page import MAX_CACHED, Page  # noqa: E402
from rkhs_ros.view.recorded import Recorded  # noqa: E402
from rkhs_ros.view.serving import opened  # noqa: E402
from rkhs_ros.view.source import PAUSED, RUNNING  # noqa: E402

# The first message of a browser; viser counts it as a client only then.
CAMERA = {"type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 1], "fov": 1.0, "image_height": 100,
          "image_width": 100, "near": 0.1, "far": 10.0, "look_at": [0, 0, 0], "up_direction": [0, 1, 0]}  # fmt: skip
CONFIGS = Path(__file__).parents[3] / "config"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run with a recording."""
    config = load_config(CONFIGS / "toy_few_nac.yaml", ["iterations=4"])
    path = tmp_path_factory.mktemp("view") / "run"
    return run_training(config, runner_of(config.environment), path, quiet=True)


@pytest.mark.parametrize(
    ("headers", "local", "welcome"),
    [
        ({"Host": "localhost:8080", "Origin": "http://localhost:8080"}, True, True),
        ({"Host": "127.0.0.1:8080"}, True, True),
        ({"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, True, True),
        ({"Host": "localhost:8080", "Origin": "https://elsewhere.example"}, True, False),
        ({"Host": "localhost:8080", "Origin": "http://localhost:3000"}, True, False),
        ({"Host": "elsewhere.example:8080", "Origin": "http://elsewhere.example:8080"}, True, False),
        ({"Host": "robot.example:8080", "Origin": "http://robot.example:8080"}, False, True),
        ({}, True, False),
    ],
)
def test_pages_of_other_origins_are_rejected(headers: dict[str, str], local: bool, welcome: bool) -> None:
    assert is_allowed(headers, local=local) == welcome


def test_loopback_addresses_are_local() -> None:
    assert [is_local(host) for host in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "10.0.0.1", "robot", None)] == [
        True, True, True, False, False, False, False,
    ]  # fmt: skip


def test_a_control_accepts_only_values_that_a_user_can_set() -> None:
    slider = SimpleNamespace(value=3, min=0, max=10, disabled=False)
    for updates in (
        {"value": 11},
        {"value": "3"},
        {"value": float("nan")},
        {"value": True},
        {"value": None},
        {"max": 5},
    ):
        assert not is_fitting(slider, updates)
    assert is_fitting(slider, {"value": 10})
    assert not is_fitting(slider, {"value": 5, "update_cb": []})
    assert not is_fitting(SimpleNamespace(value=3, min=0, max=10, disabled=True), {"value": 5})
    chosen = SimpleNamespace(value="a", options=("a", "b"), disabled=False)
    assert is_fitting(chosen, {"value": "b"})
    assert not is_fitting(chosen, {"value": "c"})
    assert is_fitting(SimpleNamespace(value=False, disabled=False), {"value": True})


class FixedMonitor(Monitor):
    """A monitor with a fixed report and no nodes; it stores the commands."""

    def __init__(self) -> None:
        super().__init__(lambda: None)
        self.sent: list[str] = []

    def listen(self) -> Report:
        counts = dict.fromkeys(("commands", "clamps", "refusals", "stops"), 3)
        nodes = (NodeReport("/policy", "ok", ""), NodeReport("/gate", "error", "stuck: <b>too *fast*"))
        return Report(nodes, {"state": "stopped", "reason": "too fast", **counts}, "veto: refused")

    def send(self, command: str) -> None:
        self.sent.append(command)


class Served:
    """A page in this process, with access to its controls and its socket."""

    def __init__(self, path: Path) -> None:
        self.source = Recorded(path)
        self.server = opened("127.0.0.1", 0)
        self.monitor = FixedMonitor()
        self.page = Page(self.server, self.source, self.monitor)
        self.page.refresh()
        self.port = self.server.get_port()

    def connect(self, **more: Any) -> Any:
        from websockets.sync.client import connect

        version = f"viser-v{viser.__version__}"
        return connect(f"ws://127.0.0.1:{self.port}", subprotocols=[version], max_size=None, compression=None, **more)

    def control(self, label: str) -> Any:
        handles = self.server.gui._gui_input_handle_from_uuid.values()
        return next(handle for handle in handles if handle._impl.props.label == label)


@pytest.fixture
def served(folder: Path, tmp_path: Path) -> Iterator[Served]:
    path = tmp_path / "run"
    shutil.copytree(folder, path)
    page = Served(path)
    yield page
    with redirect_stdout(StringIO()):
        page.server.stop()


def packed(message: dict[str, Any]) -> bytes:
    import msgspec

    return msgspec.msgpack.encode(message)


def eventually(condition: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + 60.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return bool(condition())


def test_the_socket_is_bound_to_the_loopback_address(served: Served) -> None:
    sockets = [line.split()[1:4] for line in Path("/proc/self/net/tcp").read_text().splitlines()[1:]]
    bound = [place for place, _, state in sockets if place.endswith(f":{served.port:04X}") and state == "0A"]
    assert bound == [f"0100007F:{served.port:04X}"]
    assert not [
        line for line in Path("/proc/self/net/tcp6").read_text().splitlines()[1:] if f":{served.port:04X} " in line
    ]


def test_malformed_messages_change_nothing(served: Served, rng: np.random.Generator) -> None:
    slider, buttons = served.control("Iteration"), served.control("Run")
    update = {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid}
    garbage = [
        "text", b"", rng.bytes(1000), packed({}), packed({"type": "Nothing"}), packed({"type": "ShareUrlRequest"}),
        packed({"type": "GuiUpdateMessage"}), packed(update | {"updates": {"value": "three"}}),
        packed(update | {"updates": {"value": 10**6}}), packed(update | {"updates": {"removed": True}}),
        packed(update | {"uuid": ["a"], "updates": {"value": 1}}), packed(update | {"updates": {"update_cb": None}}),
        packed({"type": "GuiUpdateMessage", "uuid": buttons._impl.uuid, "updates": {"value": "End the run"}}),
        packed({"type": "FileTransferStartUpload", "source_component_uuid": "x", "transfer_uuid": "y", "filename": "z",
                "mime_type": "", "part_count": 1, "size_bytes": 10**12}),
    ]  # fmt: skip
    before = sorted(path.name for path in served.source.path.iterdir())
    for piece in garbage:
        with suppress(Exception), served.connect() as connection:  # the server may close it at once
            connection.send(piece)
            connection.recv(0.2)
    assert slider.value == 4
    assert sorted(path.name for path in served.source.path.iterdir()) == before
    with served.connect() as connection:
        assert len(connection.recv(10.0)) > 100
        connection.send(packed(update | {"updates": {"value": 2}}))
        assert eventually(lambda: slider.value == 2)


def test_a_page_of_another_origin_can_change_nothing(served: Served) -> None:
    slider = served.control("Iteration")
    with suppress(Exception), served.connect(origin="https://elsewhere.example") as connection:
        connection.send(packed({"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": 2}}))
        connection.recv(1.0)
    time.sleep(0.2)
    assert slider.value == 4


def test_buttons_match_the_state_of_the_run(served: Served) -> None:
    path, shown = served.source.path, served.page._buttons

    def visible() -> list[str]:
        served.page.refresh()
        return [label for buttons in shown.values() if buttons.visible for label in buttons.options]

    assert visible() == []
    with locked(path):
        assert visible() == ["Pause after this iteration", "End the run"]
        for label, word in (("Pause after this iteration", PAUSE), ("End the run", STOP)):
            press(served, shown[RUNNING], label)
            assert eventually(lambda word=word: (path / ASKED).exists() and (path / ASKED).read_text() == word)
        (path / ASKED).unlink()
        (path / "pausing").touch()
        assert visible() == ["Resume", "End the run"]
        press(served, shown[RUNNING], "End the run")  # hidden by now
        press(served, shown[PAUSED], "Resume")
        assert eventually((path / ASKED).exists)
        assert (path / ASKED).read_text() == RESUME


def press(served: Served, buttons: Any, label: str) -> None:
    with served.connect() as connection:
        connection.recv(10.0)
        connection.send(packed(CAMERA))
        assert eventually(lambda: len(served.server.get_clients()) > 0)
        before = buttons.update_timestamp
        connection.send(packed({"type": "GuiUpdateMessage", "uuid": buttons._impl.uuid, "updates": {"value": label}}))
        assert eventually(lambda: buttons.update_timestamp > before)


def test_gate_and_nodes_are_shown_while_the_run_is_in_progress(served: Served) -> None:
    panel = served.page._nodes
    served.page.listen()
    assert not panel._robot.visible
    assert not panel._nodes.visible
    with locked(served.source.path):
        served.page.refresh()
        served.page.listen()
    assert panel._robot.visible
    assert panel._nodes.visible
    assert "The gate is **stopped**: too fast" in panel._gate.content
    assert "type `rkhs robot arm`" in panel._gate.content
    assert "3 commands: 3 limited, 3 refused; 3 stops" in panel._gate.content
    assert panel._nodes.content.splitlines()[0] == r"**/gate error** stuck: \<b\>too \*fast\*"
    assert "Nodes without problems: policy" in panel._nodes.content
    assert panel._answer.content == "veto: refused"
    served.page.stop_listening()
    assert not panel._robot.visible


def test_no_request_arms_a_robot(served: Served) -> None:
    """Send all values and names that could mean arming to every control of the page."""
    with locked(served.source.path), served.connect() as connection:
        served.page.refresh()
        served.page.listen()
        connection.recv(10.0)
        connection.send(packed(CAMERA))
        assert eventually(lambda: len(served.server.get_clients()) > 0)
        for uuid in [*served.server.gui._gui_input_handle_from_uuid, "arm", "gate/arm"]:
            for updates in ({"value": True}, {"value": "arm"}, {"arm": True}, {"value": True, "word": "arm"}):
                connection.send(packed({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}))
        assert eventually(lambda: served.monitor.sent == ["stop"])
        uuid = served.control("Episodes")._impl.uuid
        for number, (label, word) in enumerate(EPISODES.items(), start=2):
            connection.send(packed({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": label}}))
            assert eventually(lambda number=number: len(served.monitor.sent) == number)
            assert served.monitor.sent[-1] == word
    for path in (Path(page.__file__).parent).glob("*.py"):
        assert not re.search(r"""["'](gate/|~/)?arm["']""", path.read_text()), path


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_memory_stays_bounded_over_a_long_run(tmp_path: Path) -> None:
    config = load_config(CONFIGS / "toy_few_nac.yaml", ["iterations=3000", "horizon=10", "evaluate_every=0"])
    path = run_training(config, runner_of(config.environment), tmp_path / "run", quiet=True)
    source = Recorded(path)
    page = Page(opened("127.0.0.1", 0), source, Monitor(lambda: None))
    page.refresh()
    sizes = {}
    for number in range(30, 3001, 30):
        page._iteration.value = number
        page.tick()
        sizes[number] = resident_bytes()
    print({number: f"{size / 1e6:.0f} MB" for number, size in sizes.items() if number % 300 == 0})
    assert page._load.cache_info().currsize <= MAX_CACHED
    assert sizes[3000] - sizes[300] < 35e6  # stored pictures alone would take 180 MB


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize("host", ["999.1.1.1", "192.0.2.1", "a..b"])
def test_an_address_of_another_machine_is_rejected(host: str) -> None:
    with pytest.raises(ValueError, match=r"host: expected an address of this machine, got "):
        opened(host, 0)
