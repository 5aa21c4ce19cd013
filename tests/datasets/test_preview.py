"""The preview: LeRobot loads it, browsers play it, and its card says how far it is from the exact images."""

import functools
import http.server
import importlib.util
import threading
import time
from pathlib import Path
from types import ModuleType

import av
import numpy as np
import pytest

from gym_open.datasets.preview import export_preview
from gym_open.errors import UsageError
from gym_open.formats.releases import open_release
from gym_open.workspace import template
from tests.children import python
from tests.datasets.compact.conftest import learned_log, packed, random_log, release  # noqa: F401  # fixtures

VIDEO = "videos/observation.image/chunk-000/file-000.mp4"
PAGE = """<video muted src="film.mp4"></video><script>
window.played = new Promise((done, failed) => {
  const film = document.querySelector("video");
  film.onended = () => done([film.videoWidth, film.videoHeight, film.duration]);
  film.onerror = () => failed(film.error.message);
  film.playbackRate = 8; film.play();
});</script>"""
PLAYED = """new Promise(done => {
  const look = () => window.played ? window.played.then(done, reason => done([reason])) : setTimeout(look, 50);
  look();
})"""


@pytest.fixture(scope="module")
def preview(packed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: F811
    return export_preview(packed, tmp_path_factory.mktemp("preview") / "preview")


def test_its_video_is_what_browsers_play_and_near_the_exact_images(preview: Path, release: Path) -> None:  # noqa: F811
    with av.open(str(preview / VIDEO)) as film:
        stream = film.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        images = np.stack([frame.to_ndarray(format="rgb24") for frame in film.decode(stream)])
    exact = open_release(release).images(np.arange(len(images)))
    assert images.shape[1:3] == (168, 168)
    error = np.abs(images[:, ::2, ::2].astype(int) - exact)
    assert error.mean() < 2
    card = (preview / "README.md").read_text()
    assert "Do not train on it" in card
    assert "PSNR" in card


def test_lerobot_loads_it(preview: Path, release: Path) -> None:  # noqa: F811
    frames = len(open_release(release))
    python(f"""
        import os
        os.environ["HF_HUB_OFFLINE"] = "1"
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
        dataset = LeRobotDataset("open/preview", root={str(preview)!r}, video_backend="pyav")
        assert len(dataset) == {frames}
        assert tuple(dataset[3]["observation.image"].shape) == (3, 168, 168)
        assert dataset.meta.video_keys == ["observation.image"]
    """)


def _browser() -> ModuleType:
    spec = importlib.util.spec_from_file_location("browser", template() / "docs/browser.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_browser_plays_it(preview: Path, tmp_path: Path) -> None:
    browser = _browser()
    program = browser.find()
    if program is None:
        pytest.skip("no Chromium here")
    (tmp_path / "film.mp4").write_bytes((preview / VIDEO).read_bytes())
    (tmp_path / "index.html").write_text(PAGE)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with browser.Browser(program, 400, 300) as page:
            page.open(f"http://127.0.0.1:{server.server_port}/")
            time.sleep(1)  # until the page is there
            said = page.call("Runtime.evaluate", expression=PLAYED, awaitPromise=True, returnByValue=True)
            width, height, seconds = said["result"]["value"]
        server.shutdown()
    assert (width, height) == (168, 168)
    assert seconds > 0


def test_what_is_there_is_kept(preview: Path, release: Path) -> None:  # noqa: F811
    with pytest.raises(UsageError, match="exists"):
        export_preview(release, preview)
