"""Destinations of views: complete files, a window only with a display, and a page only on the loopback address."""

import importlib.util
import io
import os
import re
import resource
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image

from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.viz import viewers
from gym_open.viz.film import write_whole
from gym_open.viz.view import View
from tests.children import HANG_S, is_alive, run, started, until

ROOT = Path(__file__).parents[2]
STEPS, VALUES = np.arange(1000), np.sin(np.arange(1000) / 50)
VERMILION = (213, 94, 0)
SERVE = """
import runpy, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores SIGINT for background processes
sys.path.insert(0, sys.argv[1])
runpy.run_path(sys.argv[2])[sys.argv[3]]()
"""


def wave() -> View:
    def fill(rec: rr.RecordingStream) -> None:
        at = [rr.TimeColumn("step", sequence=STEPS)]
        rec.send_columns("wave", at, rr.Scalars.columns(scalars=VALUES))
        rec.log("wave", rr.SeriesLines(colors=VERMILION, widths=4), static=True)

    plot = rrb.TimeSeriesView(origin="/wave", name="wave")
    return View("a wave", fill, rrb.Blueprint(plot, collapse_panels=True, auto_views=False))


def serve() -> None:
    """Runs in a separate process."""
    viewers._PATIENCE = HANG_S
    viewers.web(wave())


def serve_and_swallow() -> None:
    """A library swallows the KeyboardInterrupt of Ctrl-C. Runs in a separate process."""

    def fill(rec: rr.RecordingStream) -> None:
        wave().fill(rec)
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            signal.pause()

    viewers._PATIENCE = HANG_S
    viewers.web(wave()._replace(fill=fill))


def broken(error: Exception) -> View:
    def fill(rec: rr.RecordingStream) -> None:
        rec.log("wave", rr.Scalars(1.0), static=True)
        raise error

    return wave()._replace(fill=fill)


def test_a_saved_view_is_complete(tmp_path: Path, read_back: Callable[[Path], Any]) -> None:
    path = viewers.save(wave(), tmp_path / "deep" / "wave.rrd")
    recording = read_back(path)
    steps, values = recording.column("/wave", "Scalars:scalars")
    assert steps == STEPS.tolist()
    assert np.ravel(values).tolist() == VALUES.tolist()
    assert recording.store.application_id == "gym-open: a wave"
    assert [item.name for item in path.parent.iterdir()] == ["wave.rrd"]


def test_a_failed_view_keeps_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "old.rrd").write_text("old")
    for name in ("old.rrd", "new.rrd"):
        with pytest.raises(ArtefactError, match="is damaged"):
            viewers.save(broken(ArtefactError("it is damaged")), tmp_path / name)
    assert [(item.name, item.read_text()) for item in tmp_path.iterdir()] == [("old.rrd", "old")]


def test_a_terminated_process_leaves_no_file(tmp_path: Path) -> None:
    hidden: list[str] = []

    def fill(rec: rr.RecordingStream) -> None:
        rec.log("wave", rr.Scalars(1.0), static=True)
        hidden.extend(item.name for item in tmp_path.iterdir())
        os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(KeyboardInterrupt):
        viewers.save(wave()._replace(fill=fill), tmp_path / "wave.rrd")
    assert hidden == [f".wave.rrd.{os.getpid()}.tmp"]  # another process writes to another file
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_no_file_is_written_into_an_artefact(tmp_path: Path) -> None:
    for name in ("manifest.json", "lineage.json"):
        (tmp_path / name).touch()
    before = sorted(tmp_path.iterdir())
    with pytest.raises(UsageError, match=r"in the artefact .*whose files are fixed"):
        viewers.save(wave(), tmp_path / "deep" / "wave.rrd")
    with pytest.raises(UsageError, match="in the artefact"):
        write_whole(tmp_path / "wave.png", Path.touch)
    assert sorted(tmp_path.iterdir()) == before


def test_a_full_disk_is_an_error_and_leaves_no_file(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(ArtefactError, match=r"wave\.rrd: cannot be written .*make room"):
            viewers.save(wave(), tmp_path / "wave.rrd")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_path_and_another_suffix_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ArtefactError, match="cannot be written"):
        viewers.save(wave(), tmp_path / "file" / "wave.rrd")
    with pytest.raises(UsageError, match=r"must end in \.rrd, got '\.mp4'"):
        viewers.save(wave(), tmp_path / "wave.mp4")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_without_a_display_no_window_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(UsageError, match=r"DISPLAY is not set.*--save FILE\.rrd, --web"):
        viewers.native(wave())
    monkeypatch.setenv("DISPLAY", ":987")  # no display has this number
    monkeypatch.setattr(viewers, "_PATIENCE", HANG_S)
    monkeypatch.setattr(viewers, "_GRACE", HANG_S)
    with pytest.raises(GymOpenError, match=r"Rerun's viewer ended \(Error: .*X server.*--save"):
        viewers.native(wave())


@pytest.fixture
def served() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process that serves the wave, and its printed address."""
    words = [sys.executable, "-c", SERVE, str(ROOT), __file__, "serve"]
    with started(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        (address,) = re.findall(r"a wave is at (http://127\.0\.0\.1:[0-9]+)\n", process.stdout.readline())
        yield process, address


def children(parent: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]


def listening(process: int) -> set[str]:
    """Addresses, in hex, that a process listens on."""
    sockets = {
        str(link.readlink()) for link in Path(f"/proc/{process}/fd").iterdir() if link.exists() or link.is_symlink()
    }
    lines = [
        line.split()
        for name in ("tcp", "tcp6")
        for line in Path(f"/proc/{process}/net/{name}").read_text().splitlines()
    ]
    return {line[1].split(":")[0] for line in lines if line[3] == "0A" and f"socket:[{line[9]}]" in sockets}


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGKILL])
def test_the_page_is_on_the_loopback_address_only_and_no_child_is_left(
    served: tuple[subprocess.Popen[str], str], sign: signal.Signals
) -> None:
    process, address = served
    with urllib.request.urlopen(address, timeout=HANG_S) as answer:
        assert "Rerun" in answer.read().decode()
        allowed = answer.headers["Content-Security-Policy"]
    assert (
        set(re.findall(r"http://[^ ;]+", allowed)) == set(re.findall(r"http://127\.0\.0\.1:[0-9]+", allowed)) != set()
    )
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(f"{address}/../../etc/passwd", timeout=HANG_S)
    (program,) = children(process.pid)
    assert listening(process.pid) | listening(program) == {"0100007F"}  # 127.0.0.1
    process.send_signal(sign)
    assert process.wait() == (-sign if sign == signal.SIGKILL else 0)
    until(lambda: not is_alive(program))


def test_ctrl_c_ends_the_page_although_a_library_swallows_it() -> None:
    done = run([sys.executable, "-c", SERVE, str(ROOT), __file__, "serve_and_swallow"])
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("  all data is loaded\n")


@pytest.fixture
def camera() -> ModuleType:
    spec = importlib.util.spec_from_file_location("browser", ROOT / "docs" / "browser.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_browser_shows_the_page_and_contacts_no_other_host(
    served: tuple[subprocess.Popen[str], str], camera: ModuleType
) -> None:
    program = camera.find()
    if program is None:
        pytest.skip("no Chromium here")
    with camera.Browser(program, 900, 600) as browser:
        browser.open(served[1])
        picture = np.asarray(Image.open(io.BytesIO(browser.still())).convert("RGB")).astype(int)
        requests = {
            event["params"]["requestId"]: event["params"]["request"]["url"]
            for event in browser.events
            if event["method"] == "Network.requestWillBeSent"
        }
        refused = {
            event["params"]["requestId"]
            for event in browser.events
            if event["method"] == "Network.loadingFailed" and event["params"].get("blockedReason") == "csp"
        }
    drawn = np.abs(picture - VERMILION).max(axis=2) < 30
    assert np.count_nonzero(drawn.any(axis=0)) > 500  # the wave, from left to right
    elsewhere = {key for key, url in requests.items() if not url.startswith(("http://127.0.0.1:", "data:", "blob:"))}
    assert elsewhere <= refused
