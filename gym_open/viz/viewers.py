"""Destinations of a view: a file, Rerun's window, or a page on the loopback address. No data leaves this machine.

Rerun's program shows the window and the page. It is a child process that ends with the command. It gets the data while
the source is read, so the first image appears before the last step is read.
"""

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import rerun as rr
import rerun_cli

from gym_open.errors import GymOpenError, UsageError
from gym_open.processes import end_with_parent, interruptible
from gym_open.terminal import printable
from gym_open.viz.film import write_whole
from gym_open.viz.view import View
from gym_open.viz.web_page import LOOPBACK, PageServer

APPLICATION = "gym-open"
WEB_PORT, DATA_PORT = 9090, 9876
"""Rerun's default ports of the page and of its data; if one is taken, another free port is used."""
_PATIENCE = 30.0
"""Seconds to wait until Rerun's program listens."""
_GRACE = 5.0
"""Seconds that Rerun's program gets to end."""
_POLL = 0.1
"""Seconds between two checks whether the program has ended."""
_PROGRAM = Path(rerun_cli.__file__).with_name("rerun")
_OTHER_WAYS = "--save FILE.rrd, --web, --video FILE.mp4 and --png FILE.png need no display"


def save(view: View, path: Path) -> Path:
    """Write the view as a recording, completely or not at all, and return its path.

    Raises:
        ArtefactError: if the source is missing or damaged, or the file cannot be written.
        UsageError: if the name does not end in `.rrd`, or the path lies in a finished artefact.
    """
    if path.suffix != ".rrd":
        raise UsageError(f"{path}: a recording's name must end in .rrd, got {path.suffix or 'no ending'!r}")
    return write_whole(path, lambda partial: partial.write_bytes(_recorded(view)))


def native(view: View) -> None:
    """Show the view in Rerun's window until the window is closed or Ctrl-C is pressed.

    Raises:
        ArtefactError: if the source is missing or damaged.
        UsageError: if there is no display.
        GymOpenError: if the window cannot be opened.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UsageError(f"there is no display to open a window on (DISPLAY is not set); {_OTHER_WAYS}")
    with interruptible() as interrupted, _RerunProgram("--expect-data-soon") as program:
        program.show(view, interrupted)


def web(view: View) -> None:
    """Serve the view as a page on 127.0.0.1 only, until Ctrl-C is pressed.

    Raises:
        ArtefactError: if the source is missing or damaged.
        GymOpenError: if Rerun's program does not start.
    """
    inner = free_port(0)
    with (
        interruptible() as interrupted,
        _RerunProgram("--serve-web", "--web-viewer-port", str(inner)) as program,
        PageServer(free_port(WEB_PORT), inner, program.port) as page,
    ):
        here = f"{LOOPBACK}:{page.port}"
        forward = " ".join(f"-L {port}:{LOOPBACK}:{port}" for port in (page.port, program.port))
        print(f"gym-open viz: {printable(view.title)} is at http://{here}")
        print(f"  from another host, first run there: ssh {forward} THIS-HOST\n  stop: Ctrl-C", flush=True)
        program.show(view, interrupted, then="  all data is loaded")


def _recorded(view: View) -> bytes:
    """The view as the bytes of a recording. Rerun's own file writer (0.41) can block forever on a full disk."""
    streams: list[rr.BinaryStream] = []
    try:
        _stream(view, lambda rec: streams.append(rec.binary_stream()))
    finally:  # Rerun warns about bytes that are not read
        data = streams[0].read(flush=False) if streams else None
    return data or b""


class _LostError(Exception):
    """Data could not be sent to Rerun."""


def _stream(view: View, connect: Callable[[rr.RecordingStream], None]) -> None:
    """Fill a recording that `connect` sends to a destination.

    Raises:
        _LostError: if some data was not sent.
    """
    rec = rr.RecordingStream(f"{APPLICATION}: {view.title}")  # Rerun keeps one layout per application
    try:
        with _lost():
            connect(rec)
            rec.send_recording_name(view.title)
            rec.send_blueprint(view.blueprint)
        view.fill(rec)
        with _lost():
            rec.flush()
    finally:
        with suppress(RuntimeError):  # the loss has been reported
            rec.disconnect()


@contextmanager
def _lost() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        raise _LostError(str(error)) from None


class _RerunProgram:
    """Rerun's program, which listens for data on the loopback address and ends with this context."""

    def __init__(self, *options: str) -> None:
        self.port = free_port(DATA_PORT)
        self._home = tempfile.TemporaryDirectory(prefix="gym-open-rerun-")
        self._output = Path(self._home.name, "output.txt")
        words = [str(_PROGRAM), "--bind", LOOPBACK, "--port", str(self.port), *options]
        with self._output.open("wb") as output:
            self._process = subprocess.Popen(  # noqa: S603  (Rerun's program, our options)
                words,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=_silent(Path(self._home.name)),
                start_new_session=True,  # Ctrl-C goes to this process, which then ends the program
                preexec_fn=end_with_parent,  # noqa: PLW1509  (it only makes a system call)
            )

    def __enter__(self) -> Self:
        try:
            self._await_port()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def show(self, view: View, interrupted: Callable[[], bool], then: str | None = None) -> None:
        """Send the view, print `then`, and wait until the program ends or `interrupted` returns true."""
        url = f"rerun+http://{LOOPBACK}:{self.port}/proxy"
        try:
            with self._watched():
                _stream(view, lambda rec: rec.connect_grpc(url))
            if then:
                print(then, flush=True)
            while self._process.poll() is None and not interrupted():
                time.sleep(_POLL)
        except KeyboardInterrupt:
            pass  # the usual end, also if the window is closed while data is sent
        except _LostError as error:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_GRACE)  # the connection closes shortly before the program ends
            if self._process.poll() is None:
                raise GymOpenError(
                    f"Rerun's viewer does not accept data ({error}); run the same command again"
                ) from None
        if self._process.poll():
            raise self._failure()

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Interrupt the main thread when the program ends, because the data is no longer needed."""
        done = threading.Event()

        def watch() -> None:
            self._process.wait()
            if not done.is_set():
                interrupt_main()

        threading.Thread(target=watch, daemon=True).start()
        try:
            yield
        finally:
            done.set()

    def _await_port(self) -> None:
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until:
            if self._process.poll() is not None:
                raise self._failure()
            with socket.socket() as probe:
                if probe.connect_ex((LOOPBACK, self.port)) == 0:
                    return
            time.sleep(0.05)
        raise self._failure()

    def _failure(self) -> GymOpenError:
        lines = self._output.read_text(encoding="utf-8", errors="replace").splitlines()
        reason = next((line for line in reversed(lines) if line.startswith("Error: ")), "\n".join(lines[-1:]))
        return GymOpenError(f"Rerun's viewer ended ({printable(reason) or 'without a message'}); {_OTHER_WAYS}")

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._home.cleanup()


def _silent(home: Path) -> dict[str, str]:
    """The environment variables with which Rerun's program sends no usage statistics to its makers.

    The program reads this setting from the user's configuration folder. On Linux a temporary folder replaces it for
    this program. On other systems the user's own setting applies (`rerun analytics disable`).
    """
    if sys.platform != "linux":
        return dict(os.environ)
    environment = {**os.environ, "XDG_CONFIG_HOME": str(home)}
    words = [str(_PROGRAM), "analytics", "disable"]
    subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, env=environment, check=True)  # noqa: S603
    return environment


def free_port(wanted: int) -> int:
    """The wanted port on the loopback address if it is free, otherwise another free port."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, wanted))
        except OSError:
            probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]
