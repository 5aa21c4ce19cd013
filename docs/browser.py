"""Screenshots with headless Chromium, through its debugging protocol on a pipe: without a port or a library."""

import base64
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from types import TracebackType
from typing import Any, Self

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_OPTIONS = (
    "--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--no-first-run", "--disable-background-networking",
    "--hide-scrollbars", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
_FROM_US, _TO_US = 3, 4
"""File descriptors that Chromium reads from and writes to."""
_DRAWN = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 500))))"
"""A promise that resolves after the page has drawn itself twice."""
_EMPTY = 40_000
"""A PNG with fewer bytes shows an empty page."""


def find() -> str | None:
    """The path of Chromium, or None if it is not installed."""
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page of a browser, which ends with this context. `events` holds all events of the page."""

    def __init__(self, program: str, width: int, height: int) -> None:
        self.events: list[dict[str, Any]] = []
        self._home = tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True)
        theirs, self._out = os.pipe()
        self._in, mine = os.pipe()

        def wire() -> None:
            first, second = os.dup(theirs), os.dup(mine)  # either of them may already be 3 or 4
            os.dup2(first, _FROM_US)
            os.dup2(second, _TO_US)

        self._process = subprocess.Popen(  # noqa: S603  (a browser on a page of ours)
            [
                program,
                *_OPTIONS,
                f"--user-data-dir={self._home.name}",
                f"--window-size={width},{height}",
                "about:blank",
            ],
            preexec_fn=wire,  # noqa: PLW1509  (nothing else runs here yet)
            close_fds=False,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs)
        os.close(mine)
        self._sent, self._read, self._session = 0, b"", ""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.call("Network.enable")
        self.size = (width, height)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        os.close(self._in)
        os.close(self._out)
        self._home.cleanup()

    def call(self, method: str, **values: Any) -> dict[str, Any]:
        """Call a method of the browser, and return its result."""
        self._sent += 1
        message = {"id": self._sent, "method": method, "params": values}
        if self._session:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._out, data) :]
        while (answer := self._receive()).get("id") != self._sent:
            self.events.append(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._read:
            got = os.read(self._in, 1 << 16)
            if not got:
                raise RuntimeError("the browser ended")
            self._read += got
        message, _, self._read = self._read.partition(b"\0")
        return json.loads(message)

    def open(self, address: str) -> None:
        """Open a page."""
        self.call("Page.navigate", url=address)

    def picture(self) -> bytes:
        """A screenshot of the page as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def still(self, *, limit: float = 120.0, calm: float = 8.0) -> bytes:
        """A screenshot when the page is not empty and has not changed for `calm` seconds, at latest after `limit`."""
        until, since, last = time.monotonic() + limit, time.monotonic(), b""
        while time.monotonic() < until:
            time.sleep(0.5)
            self.call("Runtime.evaluate", expression=_DRAWN, awaitPromise=True)
            now = self.picture()
            if now != last:
                last, since = now, time.monotonic()
            elif len(now) > _EMPTY and time.monotonic() - since > calm:
                break
        return last

    def click(self, x: int, y: int) -> None:
        """Click at a position, and move the pointer away."""
        for kind, count in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 1)):
            self._point(kind, x, y, button="left" if count else "none", clickCount=count)
            time.sleep(0.2)
        self._point("mouseMoved", self.size[0] - 2, self.size[1] - 2)

    def _point(self, kind: str, x: int, y: int, **values: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **values)
