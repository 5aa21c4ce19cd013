"""Figures of puzzles: film strips, and all puzzles of a task."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from gym_open.errors import UsageError
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.export import write_still
from gym_open.viz.film import enlarged
from gym_open.viz.puzzles.episodes import play_all
from gym_open.viz.puzzles.still import shown_steps, strips

MakeLog = Callable[..., Path]
PLAIN = VizConfig(film_look="observation")


def drawn(paint: Callable[[Figure], None]) -> dict[str, Any]:
    """Return the axes of a figure by their titles."""
    figure = Figure(layout="constrained")
    paint(figure)
    return {axes.get_title() or axes.get_title("left"): axes for axes in figure.axes}


def test_a_puzzle_is_a_film_strip_of_each_agent(scores: Any, policy: Path, tmp_path: Path) -> None:
    sources = [scores.path, policy]
    played = play_all("avoidance/000", sources)
    _, _, paint = strips(played, "observation")
    axes = drawn(paint)
    end = played.episodes[0].steps
    picture = axes[f"action {end}: touches yellow_0"].get_images()[0].get_array()
    np.testing.assert_array_equal(picture, enlarged(played.episodes[0].images[-1], 280))
    (value,) = axes["value: return that the policy expects"].get_lines()
    assert played.episodes[0].policy is not None
    values = played.episodes[0].policy.values
    np.testing.assert_array_equal(value.get_ydata(), [*values, values[-1]])  # the last holds until its action's end
    assert len(axes["return so far"].get_lines()) == 2
    assert write_still(PLAIN, sources, Choice(puzzle="avoidance/000"), tmp_path / "a.png").is_file()


def test_beginning_end_and_touches_are_always_shown(scores: Any) -> None:
    solved = play_all("avoidance/000", [scores.path]).episodes[0]
    assert shown_steps(solved) == list(range(solved.steps + 1))
    long = play_all("avoidance/001", [scores.path]).episodes[0]
    assert shown_steps(long) == [0, 17, 33, 50, 67, 83, 100]


def test_all_puzzles_on_a_page(scores: Any, others: Any, tmp_path: Path) -> None:
    with Image.open(write_still(PLAIN, [scores.path, others.path], Choice(), tmp_path / "all.png")) as page:
        pixels = np.asarray(page.convert("RGB")).reshape(-1, 3)
    for colour in ((253, 231, 55), (0, 34, 77), (213, 94, 0)):  # solved, not solved, in the danger patch
        assert (np.abs(pixels.astype(int) - colour).max(axis=1) < 3).sum() > 100


def test_what_has_no_page_is_refused(scores: Any, policy: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ends in \.png, got '\.jpg'"):
        write_still(PLAIN, [scores.path], Choice(), tmp_path / "a.jpg")
    with pytest.raises(UsageError, match="--png: cannot draw policy as a page; give one log or release, scores"):
        write_still(PLAIN, [policy], Choice(), tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
