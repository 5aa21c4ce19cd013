"""Pages for people without Rerun: what is drawn on them is what was recorded."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from gym_open.formats.logs import log_files, open_log
from gym_open.viz.choice import Choice
from gym_open.viz.config import VizConfig
from gym_open.viz.play.page import open_streams
from gym_open.viz.play.still import play_page
from gym_open.viz.still import write_still

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


def test_a_page_of_play(log: Path, tmp_path: Path) -> None:
    with Image.open(write_still(PLAIN, [log], Choice(), tmp_path / "new" / "play.png")) as page:
        assert page.width > 1200
        assert np.ptp(np.asarray(page.convert("L"))) == 255
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["play.png"]


def test_play_is_drawn_as_it_was_recorded(log: Path) -> None:
    title, streams = open_streams(log, Choice())
    _, _, paint = play_page(title, streams)
    axes = drawn(paint)
    segments = list(open_log(log_files(log)[0]).segments())
    every = [np.concatenate([getattr(item, name) for item in segments]) for name in ("intrinsic_reward", "value")]
    (reward,) = axes["intrinsic reward"].get_lines()
    for line, values in ((reward, every[0]), (axes["policy"].get_lines()[1], every[1])):
        np.testing.assert_allclose(line.get_ydata(), [*values, values[-1]])  # the last holds until its step's end
        np.testing.assert_array_equal(line.get_xdata(), np.arange(25))
    assert axes["world-model loss"].get_lines()[1].get_ydata()[0] == 0.25
    first = axes["step 0\nworld 0"].get_images()[0].get_array()
    np.testing.assert_array_equal(first, segments[0].images[0])
    last = axes["step 24\nworld 0"].get_images()[0].get_array()
    np.testing.assert_array_equal(last, segments[-1].images[-1])


def test_the_page_names_the_steps_and_the_counts(make_log: MakeLog) -> None:
    """One step, seen in one cell: there is a line, and a bar of colours without formulas."""
    title, streams = open_streams(make_log(lengths=((1,),)), Choice())
    _, _, paint = play_page(title, streams)
    figure = Figure(layout="constrained")
    paint(figure)
    figure.draw_without_rendering()
    (heading,) = [part.get_suptitle() for part in figure.subfigs if part.get_suptitle()]
    assert heading.endswith("steps 0 to 0, 0.0 s")
    (reward,) = next(axes for axes in figure.axes if axes.get_title("left") == "intrinsic reward").get_lines()
    assert np.ptp(reward.get_xdata()) == 1
    (bar,) = (axes for axes in figure.axes if axes.get_xlabel().startswith("steps (grey"))
    assert not any("$" in label.get_text() for label in bar.get_xticklabels(which="both"))


def test_play_without_a_world_model_says_nothing_of_it(make_log: MakeLog) -> None:
    title, streams = open_streams(make_log(lengths=((1,),), world_model=False), Choice())
    _, _, paint = play_page(title, streams)
    axes = drawn(paint)
    assert "intrinsic reward" in axes
    assert not any("loss" in name for name in axes)
    assert sum(name.startswith("step ") for name in axes) == 2


def test_a_reward_that_nothing_made_is_not_drawn(staged_log: Path) -> None:
    title, streams = open_streams(staged_log, Choice())
    _, _, paint = play_page(title, streams)
    axes = drawn(paint)
    assert "policy" in axes
    assert not any("reward" in name for name in axes)
