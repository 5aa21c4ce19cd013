"""Figures: the same bytes for the same data, whatever the user's own style; nothing in a name is a formula."""

import dataclasses
from collections import Counter

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from gym_open.datasets import Release
from gym_open.datasets.documents.facts import ReleaseFacts, gather
from gym_open.datasets.documents.figures import (
    _COLUMNS,
    _ENDS,
    _GAP,
    _HEAD,
    _LABEL,
    _ZOOM,
    _actions,
    _episodes,
    _pick,
    draw,
)
from gym_open.plots import plain_style, png


@pytest.fixture(scope="module")
def facts(release: Release) -> ReleaseFacts:
    return gather(release)


def test_equal_data_give_equal_bytes_in_any_style(facts: ReleaseFacts, release: Release) -> None:
    with mpl.rc_context({"figure.facecolor": "black", "font.size": 30, "savefig.dpi": 30}):
        again = draw(facts)
    assert again == {path.name: path.read_bytes() for path in (release.root / "figures").iterdir()}


def test_pictures_hold_no_text_of_their_own(release: Release) -> None:
    for path in (release.root / "figures").iterdir():
        with Image.open(path) as picture:
            picture.load()
            assert not set(picture.info) - {"dpi"}
            assert min(picture.size) >= 200


def test_the_contact_sheet_shows_frames_of_the_release(facts: ReleaseFacts, release: Release) -> None:
    with Image.open(release.root / "figures/frames.png") as picture:
        sheet = np.asarray(picture.convert("RGB"))
    side, row_height = 84 * _ZOOM, 84 * _ZOOM + _GAP + _HEAD
    for row, one in enumerate(facts.explorers):
        rows = release.episodes[release.episodes["explorer"] == one.explorer]
        numbers, worlds = _pick(rows)
        for column, (number, world) in enumerate(zip(numbers, worlds, strict=True)):
            left, top = _LABEL + column * (side + _GAP), row * row_height + _HEAD
            shown = sheet[top : top + side : _ZOOM, left : left + side : _ZOOM]
            np.testing.assert_array_equal(shown, release.images([number])[0])
            place = rows[(rows["dataset_from_index"] <= number) & (number < rows["dataset_to_index"])]
            assert place["puzzle"].tolist() == [world]
        assert len(numbers) == _COLUMNS
        assert set(worlds) == set(rows["puzzle"])


def test_hostile_names(facts: ReleaseFacts) -> None:
    name = "$\\frac{$ \x1b[2J " + "x" * 400
    played = [dataclasses.replace(one, explorer=name, ended=Counter({name: one.episodes})) for one in facts.explorers]
    with plain_style():
        for figure in (_actions, _episodes):
            assert png(figure(dataclasses.replace(facts, explorers=played))).startswith(b"\x89PNG")


def test_colours_are_told_apart_by_the_colour_blind() -> None:
    """Any two colours of reasons differ also for red-blind and green-blind eyes (Viénot, Brettel, Mollon 1999)."""
    red_blind = np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]])
    green_blind = np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]])
    colours = np.array([to_rgb(colour) for colour, _ in _ENDS[:4]]) ** 2.2
    for matrix in (red_blind, green_blind):
        seen = np.clip(colours @ matrix.T, 0, 1) ** (1 / 2.2)
        distance = np.linalg.norm(seen[:, None] - seen[None], axis=-1)
        assert distance[~np.eye(len(seen), dtype=bool)].min() > 0.1
    assert len({hatch for _, hatch in _ENDS}) == len(_ENDS)
