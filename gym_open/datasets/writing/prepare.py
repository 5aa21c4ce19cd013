"""Prepare an episode for writing, in threads: encoded images, statistics, digests."""

from typing import Any

import msgspec
import numpy as np

from gym_open.datasets.writing.sources import SourceEpisode
from gym_open.datasets.writing.statistics import Stats, feature_stats, image_stats
from gym_open.datasets.writing.video import Coding, decode_clip, encode_clip, pixel_error
from gym_open.errors import ArtefactError
from gym_open.formats.pngs import decode_untrusted, encode_pngs
from gym_open.formats.releases.content import feature_digest
from gym_open.formats.releases.layout import IMAGE
from gym_open.formats.releases.schemas import PIXEL_ERROR


class Prepared(msgspec.Struct, frozen=True, eq=False):
    """An episode that is ready for writing."""

    episode: SourceEpisode
    """The episode without its images."""
    frames: int
    stats: dict[str, Stats]
    content: dict[str, str]
    pngs: list[bytes] | None = None
    clip: bytes | None = None
    """The images as mp4. Either this or `pngs` is given."""
    measured: dict[str, Any] = {}
    """Columns of `meta/episodes` about the error of encoding."""


def prepare(episode: SourceEpisode, *, video: Coding | None = None) -> Prepared:
    """Encode an episode, as PNG files or as video, and compute its statistics and digests.

    Existing PNG files are copied unchanged.
    """
    images = episode.images
    if images is None:
        assert episode.pngs is not None
        images = np.stack([_decoded(data) for data in episode.pngs])
    pngs, clip, measured = episode.pngs, None, {}
    if video:
        pngs, clip, logged = None, encode_clip(images, video), images
        images = decode_clip(clip)
        measured = {PIXEL_ERROR + name: value for name, value in pixel_error(logged, images).items()}
    elif pngs is None:
        pngs = encode_pngs(images)
    stats = {name: feature_stats(values) for name, values in episode.numbers.items()}
    content = {name: feature_digest(values) for name, values in episode.numbers.items()}
    return Prepared(
        episode=msgspec.structs.replace(episode, images=None, pngs=None),
        frames=len(images),
        stats=stats | {IMAGE: image_stats(images)},
        content=content | {IMAGE: feature_digest(images)},
        pngs=pngs,
        clip=clip,
        measured=measured,
    )


def _decoded(png: bytes) -> np.ndarray:
    try:
        return decode_untrusted(png)
    except ValueError as error:
        raise ArtefactError(f"an image of a release: {error}; find it with `gym-open dataset verify`") from None
