"""Chromium without a screen, driven by the DevTools protocol over a WebSocket."""

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from onboard.page.web import Source
from tests.page.served import served

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
CARD = "document.querySelector('.answer[data-name=\"m_payload\"]')"
_START_S = 90.0
_COMPLAINTS = ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded")


class Tab:
    """One tab.

    Attributes:
        said: lines of its console, errors of the network included.
    """

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._count = socket, 0
        self._session = ""
        self.said: list[dict[str, Any]] = []
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for method in ("Page.enable", "Runtime.enable", "Log.enable"):
            self._call(method)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        about = {"id": self._count, "method": method, "params": parameters}
        self._socket.send(json.dumps(about | ({"sessionId": self._session} if self._session else {})))
        while True:
            got = json.loads(self._socket.recv(60))
            if got.get("method") in _COMPLAINTS:
                self.said.append(got["params"])
            if got.get("id") == self._count:
                assert "error" not in got, got
                found: dict[str, Any] = got["result"]
                return found

    def open(self, url: str) -> None:
        """Load a page and its scripts."""
        self._call("Page.navigate", url=url)
        self.wait(f"location.href === {url!r} && document.readyState === 'complete'")

    def screen(self, width: int, height: int, scheme: str = "light") -> None:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self._call("Emulation.setDeviceMetricsOverride", **size)
        self._call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def shot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self._call("Page.captureScreenshot")["data"]))

    def run(self, script: str) -> Any:
        """The value of an expression in the page."""
        got = self._call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in got, got
        return got["result"].get("value")

    def wait(self, script: str) -> Any:
        """Until an expression is true."""
        until = time.monotonic() + 60
        while not (value := self.run(script)):
            assert time.monotonic() < until, f"{script} did not become true; the page: {self.text('body')[:2000]}"
            time.sleep(0.05)
        return value

    def drag(self, selector: str, first: float, last: float) -> None:
        """With the mouse, between two places along an element's width (0 to 1)."""
        box = self.run(f"document.querySelector({selector!r}).getBoundingClientRect().toJSON()")
        for kind, at in (("mousePressed", first), ("mouseMoved", last), ("mouseReleased", last)):
            place = {"x": box["left"] + at * box["width"], "y": box["top"] + box["height"] / 2}
            self._call("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **place)

    def text(self, selector: str) -> str:
        return str(self.run(f"document.querySelector({selector!r}).innerText"))


@contextmanager
def browser(profile: Path, *more: str) -> Iterator[Tab]:
    """A tab of a browser of its own.

    Args:
        profile: a new directory.
        more: options of its command line.
    """
    assert BROWSER is not None
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-dev-shm-usage"]
    options += ["--disable-background-networking", "--no-first-run", f"--user-data-dir={profile}", *more]
    told = profile / "DevToolsActivePort"
    command = [BROWSER, *options, "--remote-debugging-port=0", "about:blank"]
    environment = {**os.environ, "HOME": str(profile)}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment) as running:
        try:
            until = time.monotonic() + _START_S
            while not told.exists() or len(told.read_text().split()) < 2:
                assert running.poll() is None, "the browser did not start"
                assert time.monotonic() < until, "the browser takes no commands"
                time.sleep(0.05)
            port, path = told.read_text().split()
            with connect(f"ws://127.0.0.1:{port}{path}", max_size=None) as socket:
                yield Tab(socket)
        finally:
            running.terminate()


@contextmanager
def opened(tab: Tab, source: Source, plan: Any = None, urdf: Path | None = None) -> Iterator[None]:
    """The page of a source, open in the tab."""
    with served(source, plan=plan, urdf=urdf) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        yield
