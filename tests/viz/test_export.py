"""Films and pages for people without Rerun are decoded and compared with the recorded data."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from gym_open.errors import ArtefactError
from gym_open.formats.logs import log_files, open_log
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.export import write_still, write_video
from gym_open.viz.film import write_whole
from gym_open.viz.streams.page import open_streams
from gym_open.viz.streams.preview import preview
from gym_open.viz.streams.still import play_page
from gym_open.viz.strip import Plot, PlotLine, Strip

MakeLog = Callable[..., Path]
PLAIN = VizConfig(film_look="observation")


def drawn(paint: Callable[[Figure], None]) -> dict[str, Any]:
    """The axes of a page by their titles."""
    figure = Figure(layout="constrained")
    paint(figure)
    return {axes.get_title() or axes.get_title("left"): axes for axes in figure.axes}


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log()


def test_a_page_of_a_log(log: Path, tmp_path: Path) -> None:
    with Image.open(write_still(PLAIN, [log], Choice(), tmp_path / "new" / "play.png")) as page:
        assert page.width > 1200
        assert np.ptp(np.asarray(page.convert("L"))) == 255
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["play.png"]


def test_a_page_shows_the_recorded_data(log: Path) -> None:
    title, streams = open_streams(log, Choice())
    _, _, paint = play_page(title, streams)
    axes = drawn(paint)
    segments = list(open_log(log_files(log)[0]).segments())
    every = [np.concatenate([getattr(item, name) for item in segments]) for name in ("intrinsic_reward", "value")]
    (reward,) = axes["intrinsic reward"].get_lines()
    for line, values in ((reward, every[0]), (axes["policy"].get_lines()[1], every[1])):
        np.testing.assert_allclose(
            line.get_ydata(), [*values, values[-1]]
        )  # the last value holds until the end of its step
        np.testing.assert_array_equal(line.get_xdata(), np.arange(25))
    assert axes["world-model loss"].get_lines()[1].get_ydata()[0] == 0.25
    first = axes["step 0\nworld 0"].get_images()[0].get_array()
    np.testing.assert_array_equal(first, segments[0].images[0])
    last = axes["step 24\nworld 0"].get_images()[0].get_array()
    np.testing.assert_array_equal(last, segments[-1].images[-1])


def test_the_page_names_the_steps_and_the_counts(make_log: MakeLog) -> None:
    """Even with one step in one cell there is a line, and a colour bar without formulas."""
    title, streams = open_streams(make_log(lengths=((1,),)), Choice())
    _, _, paint = play_page(title, streams)
    figure = Figure(layout="constrained")
    paint(figure)
    figure.draw_without_rendering()
    (heading,) = [part.get_suptitle() for part in figure.subfigs if part.get_suptitle()]
    assert heading.endswith("steps 0 to 0, 0.0 s")
    (reward,) = next(axes for axes in figure.axes if axes.get_title("left") == "intrinsic reward").get_lines()
    assert np.ptp(reward.get_xdata()) == 1
    (bar,) = (axes for axes in figure.axes if axes.get_xlabel().startswith("steps (hatched"))
    assert not any("$" in label.get_text() for label in bar.get_xticklabels(which="both"))


def test_a_page_without_a_world_model_has_no_loss(make_log: MakeLog) -> None:
    title, streams = open_streams(make_log(lengths=((1,),), world_model=False), Choice())
    _, _, paint = play_page(title, streams)
    axes = drawn(paint)
    assert "intrinsic reward" in axes
    assert not any("loss" in name for name in axes)
    assert sum(name.startswith("step ") for name in axes) == 2


def test_a_reward_without_a_source_is_not_drawn(staged_log: Path) -> None:
    title, streams = open_streams(staged_log, Choice())
    _, _, paint = play_page(title, streams)
    axes = drawn(paint)
    assert "policy" in axes
    assert not any("reward" in name for name in axes)


def frames_of(path: Path) -> np.ndarray:
    frames: list[np.ndarray] = []
    with av.open(str(path)) as container:
        frames += [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    return np.array(frames)


def test_a_film_of_a_log_shows_each_step_and_the_last_observation(log: Path, tmp_path: Path) -> None:
    out = write_video(PLAIN, [log], Choice(), tmp_path / "new" / "play.mp4")
    frames = frames_of(out)
    segments = list(open_log(log_files(log)[0]).segments())
    images = np.concatenate([*[segment.images[:-1] for segment in segments], segments[-1].images[-1:]])
    assert len(frames) == len(images) == 25
    middle = ((np.arange(84) + 0.5) * 480 / 84).astype(int)  # the middle of each pixel of the enlarged observation
    seen = frames[:, middle][:, :, middle].astype(float)  # coding changes colours, but images stay distinguishable
    apart = np.abs(seen[:, None] - images[None]).mean(axis=(2, 3, 4))
    assert apart.argmin(axis=1).tolist() == list(range(25))
    assert list(out.parent.iterdir()) == [out]


def test_a_preview_is_thinned_and_holds_means(log: Path) -> None:
    _, streams = open_streams(log, Choice(stream=0))
    shown = preview(streams[0], 5)
    assert [step.step for step in shown.steps] == [0, 5, 10, 15, 20, 24]
    assert [step.world for step in shown.steps] == [0, 1, 1, 1, 0, 0]
    segments = list(open_log(log_files(log)[0]).segments())
    rewards = np.concatenate([segment.intrinsic_reward for segment in segments])
    np.testing.assert_allclose(shown.series["intrinsic_reward"], rewards)  # one bin per step
    assert shown.steps[-1].coverage.sum() == 24
    assert shown.steps[1].action == segments[1].actions[0]
    assert shown.steps[-1].action is None
    assert [plot.level for plot in shown.plots()] == [None, 0.25, None, None]
    for curve in shown.plots()[0].lines:
        assert (curve.x[-1], curve.y[-1]) == (24, rewards[-1])  # the last step is as wide as the others


def test_a_selected_part_is_previewed(log: Path) -> None:
    _, streams = open_streams(log, Choice(segment=1, stream=0))
    assert [step.step for step in preview(streams[0], 100).steps] == list(range(5, 18))
    _, streams = open_streams(log, Choice(steps=range(7, 19), stream=0))
    assert [step.step for step in preview(streams[0], 5).steps] == [
        7,
        10,
        13,
        16,
        19,
    ]  # counted from the first selected step


def test_a_gif_of_a_log(log: Path, tmp_path: Path) -> None:
    config = VizConfig(film_look="observation", film_pictures=3)
    with Image.open(write_video(config, [log], Choice(stream=1), tmp_path / "play.gif")) as film:
        assert film.n_frames == 4  # pyright: ignore
        assert film.width == 740


def test_a_failed_film_keeps_the_old_file(tmp_path: Path) -> None:
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
    strip = Strip([Plot("a spike", [PlotLine(np.arange(101), spike, "#ff0000")])], 600, 150, (0, 100), "steps")
    still = strip.at(0).astype(int)
    red = (still[..., 0] > 200) & (still[..., 1] < 100)
    drawn = np.flatnonzero(red[40:80].any(axis=0)).mean()
    changed = (strip.at(70.5) != strip.at(0)).any(axis=2)
    cursor = np.flatnonzero(changed[60] & (np.arange(600) > 200)).mean()
    assert cursor == pytest.approx(drawn, abs=3)
