"""Films decoded again, and their frames before they are coded: they show what was recorded, when it was."""

from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from gym_open.errors import ArtefactError
from gym_open.formats.logs import log_files, open_log
from gym_open.plots import coverage_image
from gym_open.viz.choice import Choice
from gym_open.viz.config import VizConfig
from gym_open.viz.film import write_whole
from gym_open.viz.play.glance import glance
from gym_open.viz.play.page import open_streams
from gym_open.viz.strip import Curve, Plot, Strip
from gym_open.viz.video import write_video

MakeLog = Callable[..., Path]
PLAIN = VizConfig(film_look="observation")


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log()


def frames_of(path: Path) -> np.ndarray:
    frames: list[np.ndarray] = []
    with av.open(str(path)) as container:
        frames += [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    return np.array(frames)


def test_a_film_of_play_shows_each_step_and_the_last_observation(log: Path, tmp_path: Path) -> None:
    out = write_video(PLAIN, [log], Choice(), tmp_path / "new" / "play.mp4")
    frames = frames_of(out)
    segments = list(open_log(log_files(log)[0]).segments())
    images = np.concatenate([*[segment.images[:-1] for segment in segments], segments[-1].images[-1:]])
    assert len(frames) == len(images) == 25
    middle = ((np.arange(84) + 0.5) * 480 / 84).astype(int)  # of each pixel; the observation is shown once, large
    seen = frames[:, middle][:, :, middle].astype(float)  # coding loses colour, not which picture it is
    apart = np.abs(seen[:, None] - images[None]).mean(axis=(2, 3, 4))
    assert apart.argmin(axis=1).tolist() == list(range(25))
    assert list(out.parent.iterdir()) == [out]


def test_a_glance_is_thinned_and_holds_means(log: Path) -> None:
    _, streams = open_streams(log, Choice(stream=0))
    play = glance(streams[0], 5)
    assert [moment.step for moment in play.moments] == [0, 5, 10, 15, 20, 24]
    assert [moment.world for moment in play.moments] == [0, 1, 1, 1, 0, 0]
    segments = list(open_log(log_files(log)[0]).segments())
    rewards = np.concatenate([segment.intrinsic_reward for segment in segments])
    np.testing.assert_allclose(play.series["intrinsic_reward"], rewards)  # a bin a step
    assert play.moments[-1].coverage.sum() == 24
    assert play.moments[1].action == segments[1].actions[0]
    assert play.moments[-1].action is None
    assert [plot.level for plot in play.plots()] == [None, 0.25, None, None]
    for curve in play.plots()[0].curves:
        assert (curve.x[-1], curve.y[-1]) == (24, rewards[-1])  # a step is as wide as the others


def test_part_of_play_is_shown(log: Path) -> None:
    _, streams = open_streams(log, Choice(segment=1, stream=0))
    assert [moment.step for moment in glance(streams[0], 100).moments] == list(range(5, 18))
    _, streams = open_streams(log, Choice(steps=range(7, 19), stream=0))
    assert [moment.step for moment in glance(streams[0], 5).moments] == [7, 10, 13, 16, 19]  # from its own first on


def test_a_gif_of_play(log: Path, tmp_path: Path) -> None:
    config = VizConfig(film_look="observation", film_pictures=3)
    with Image.open(write_video(config, [log], Choice(stream=1), tmp_path / "play.gif")) as film:
        assert film.n_frames == 4  # pyright: ignore
        assert film.width == 740


def test_what_fails_half_way_leaves_what_was_there(tmp_path: Path) -> None:
    def write(beside: Path) -> None:
        beside.write_text("half")
        raise ArtefactError("it is damaged")

    (tmp_path / "old.mp4").write_text("old")
    for name in ("old.mp4", "new.mp4"):
        with pytest.raises(ArtefactError, match="is damaged"):
            write_whole(tmp_path / name, write)
    assert [(item.name, item.read_text()) for item in tmp_path.iterdir()] == [("old.mp4", "old")]


def test_the_cursor_is_where_the_step_is_drawn() -> None:
    spike = np.zeros(101)
    spike[70] = 1.0
    strip = Strip([Plot("a spike", [Curve(np.arange(101), spike, "#ff0000")])], 600, 150, (0, 100), "steps")
    still = strip.at(0).astype(int)
    red = (still[..., 0] > 200) & (still[..., 1] < 100)
    drawn = np.flatnonzero(red[40:80].any(axis=0)).mean()
    changed = (strip.at(70.5) != strip.at(0)).any(axis=2)
    cursor = np.flatnonzero(changed[60] & (np.arange(600) > 200)).mean()
    assert cursor == pytest.approx(drawn, abs=3)


def test_coverage_is_dark_where_the_agent_never_was() -> None:
    picture = coverage_image(np.array([[0, 1], [10, 0]]), 3)
    assert picture.shape == (6, 6, 3)
    bright = picture.astype(int).sum(axis=2)[::3, ::3]
    assert bright[0, 0] == bright[1, 1] < bright[0, 1] < bright[1, 0]
