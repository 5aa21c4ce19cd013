"""Spans of a release whose pictures are a video; tests/viz/test_recording.py has the others."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.formats.pictures import decode_png
from gym_open.formats.releases import open_release
from gym_open.viz.spans import streams_of_release


def test_pictures_of_a_video_are_drawn_as_decoded(make_log: Callable[..., Path], tmp_path: Path) -> None:
    config = ReleaseConfig(pictures="video", max_episode_steps=5)
    path = build_release(config, [make_log(lengths=((7, 4),))], tmp_path / "release").path
    (stream,) = streams_of_release(path)
    spans = list(stream.spans())
    assert [span.steps for span in spans] == [5, 2, 4]
    release = open_release(path)
    by_step = release.episodes.sort_values("first_step")
    for span, first in zip(spans, by_step["dataset_from_index"], strict=True):
        numbers = np.arange(span.steps + 1)
        drawn = np.stack([decode_png(data) for data in span.pngs(numbers)])
        assert np.array_equal(drawn, release.images(first + numbers))
