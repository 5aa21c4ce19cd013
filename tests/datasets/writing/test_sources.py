"""What is told of logs before they are read is what they hold."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.agents.config import ExplorerConfig
from gym_open.config import to_dict
from gym_open.datasets import open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.writing.sources import SourceStream, explorer_of, shares_of
from gym_open.formats.logs.schemas import Switch
from gym_open.formats.releases.layout import Split

pytestmark = pytest.mark.usefixtures("no_figures")


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 2)), min_size=1, max_size=8), st.integers(1, 50))
def test_shares_are_counted_from_switches(segments: list[tuple[int, int]], cap: int) -> None:
    """Against cutting every segment by hand."""
    switches, step = [Switch(0, -1, segments[0][1], "start", [])], 0
    for place, (length, world) in enumerate(segments):
        step += length
        target = segments[place + 1][1] if place + 1 < len(segments) else -1
        switches.append(Switch(step, world, target, "learned", []))
    log = SimpleNamespace(switches=switches, puzzles=[SimpleNamespace(digest=name) for name in "abc"])
    play = SourceStream(cast("Any", log), stream=0, parent=0, explorer="")
    splits: dict[str, Split] = {"a": "train", "b": "val", "c": "train"}
    shares = shares_of(ReleaseConfig(max_episode_steps=cap), [play], splits)
    worlds_of: dict[Split, set[int]] = {"train": {0, 2}, "val": {1}}
    for split, worlds in worlds_of.items():
        pieces = [
            min(cap, length - first)
            for length, world in segments
            if world in worlds
            for first in range(0, max(length, 1), cap)
        ]
        assert shares[split] == (len(pieces), sum(pieces) + len(pieces))


@pytest.mark.parametrize(
    ("config", "name"),
    [
        ({"explorer": to_dict(ExplorerConfig())}, "curl+ride"),
        ({"explorer": {"world_model": "icm", "reward": "error"}}, "icm"),
        ({"explorer": {"world_model": "rnd", "reward": "none"}}, "rnd+random"),
        ({"explorer": {"world_model": "none", "reward": "none"}}, "random"),
        ({"explorer": {"world_model": "dreams", "reward": "none"}}, "unknown"),
        ({"explorer": "me"}, "unknown"),
        ({}, "unknown"),
    ],
)
def test_explorers_are_named_as_the_paper_does(config: dict[str, Any], name: str) -> None:
    assert explorer_of(config) == name


def test_a_segment_without_a_step_is_one_frame(make_log: Callable[..., Path], tmp_path: Path) -> None:
    """As a repaired log may end in."""
    log = make_log(lengths=((3, 0, 2, 0),))
    release = open_release(build_release(ReleaseConfig(val_fraction=0), [log], tmp_path / "r").path)
    assert release.episodes["length"].tolist() == [4, 1, 3, 1]
    assert release.column("transition.valid").tolist() == [1, 1, 1, 0, 0, 1, 1, 0, 0]
    assert np.isnan(release.column("world_model.loss")).sum() == 0
