"""Control headless Chromium through its DevTools protocol, for screenshots and tests of pages."""

import base64
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--no-first-run", "--disable-dev-shm-usage", "--disable-background-networking",
    "--remote-debugging-port=0", "--hide-scrollbars", "--mute-audio",
)  # fmt: skip
HIDDEN = "[inert]"  # ancestor of controls that cannot be used
KEYS = {"End": 35, "Home": 36}  # names and codes of keys
START_TIMEOUT_S, ANSWER_TIMEOUT_S = 30.0, 30.0
POLL_S = 0.1


def found() -> str | None:
    """Return the path of Chromium, or None if it is not installed."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Tab:
    """A tab of the browser, with a connection to its DevTools.

    Args:
        address: WebSocket address of the DevTools of the tab.
    """

    def __init__(self, address: str) -> None:
        from websockets.sync.client import connect

        self._socket = connect(address, max_size=None, compression=None)
        self._numbers = count(1)

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the protocol and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(ANSWER_TIMEOUT_S))
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return dict(answer["result"])

    def value(self, script: str) -> Any:
        """Return the value of a JavaScript expression."""
        result = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)["result"]
        return result.get("value")

    def text(self) -> str:
        """Return the visible text of the page."""
        return str(self.value("document.body ? document.body.innerText : ''"))

    def wait_for(self, script: str, timeout_s: float = 20.0) -> Any:
        """Wait until a JavaScript expression is true and return its value.

        Raises:
            TimeoutError: the expression is still false after the timeout.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if value := self.value(script):
                return value
            time.sleep(POLL_S)
        raise TimeoutError(f"{script}: not true within {timeout_s:g} s; text of the page: {self.text()!r}")

    def wait_for_text(self, text: str, timeout_s: float = 20.0) -> None:
        """Wait until the page contains a text.

        Raises:
            TimeoutError: the text does not appear within the timeout.
        """
        self.wait_for(f"document.body && document.body.innerText.includes({json.dumps(text)})", timeout_s)

    def picture(self) -> np.ndarray[Any, Any]:
        """Return a screenshot, RGB of shape (height, width, 3)."""
        content = base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(BytesIO(content)).convert("RGB"))

    def click(self, x: float, y: float) -> None:
        """Click at a position of the page, in pixels."""
        for kind in ("mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def click_on(self, script: str) -> None:
        """Wait for the element that an expression returns, and click on it."""
        self.wait_for(f"(() => {{ const e = {script}; e?.click(); return !!e; }})()")

    def press(self, script: str, key: str) -> None:
        """Press and release a key on the element that an expression returns."""
        self.value(f"{script}.focus()")
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=KEYS[key])

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class Browser:
    """A running browser.

    Args:
        port: of the DevTools.
    """

    def __init__(self, port: int) -> None:
        self._address = f"http://127.0.0.1:{port}"

    def open(self, page: str, width: int = 1000, height: int = 640) -> Tab:
        """Open a page in a new tab with a size in pixels."""
        request = Request(f"{self._address}/json/new?{page}", method="PUT")
        with urlopen(request, timeout=START_TIMEOUT_S) as answer:
            tab = Tab(json.load(answer)["webSocketDebuggerUrl"])
        tab.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        return tab


def each(selector: str) -> str:
    """Return a JavaScript expression for the usable elements that match a selector."""
    return f"[...document.querySelectorAll({json.dumps(selector)})].filter(e => !e.closest('{HIDDEN}'))"


@contextmanager
def started() -> Iterator[Browser]:
    """Start a browser, and stop it at the end of the context.

    Raises:
        FileNotFoundError: Chromium is not installed.
        TimeoutError: Chromium does not start in time.
    """
    program = found()
    if program is None:
        raise FileNotFoundError("chromium: expected an installed browser, got none. Install the package chromium")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen([program, *FLAGS, f"--user-data-dir={folder}", "about:blank"], **quiet)
        try:
            yield Browser(_port(Path(folder) / "DevToolsActivePort"))
        finally:
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _port(file: Path) -> int:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if file.exists() and (lines := file.read_text().splitlines()):
            return int(lines[0])
        time.sleep(POLL_S)
    raise TimeoutError(f"chromium did not start within {START_TIMEOUT_S:g} s")
