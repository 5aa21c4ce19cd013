"""What threads make of an episode before it is written: coded pictures, statistics, digests."""

from typing import Any

import msgspec
import numpy as np

from gym_open.datasets.writing.sources import SourceEpisode
from gym_open.datasets.writing.statistics import Stats, feature_stats, picture_stats
from gym_open.datasets.writing.video import decode_clip, encode_clip, pixel_error
from gym_open.errors import ArtefactError
from gym_open.formats.pngs import decode_untrusted, encode_pngs
from gym_open.formats.releases.content import feature_digest
from gym_open.formats.releases.layout import IMAGE
from gym_open.formats.releases.schemas import PIXEL_ERROR


class Prepared(msgspec.Struct, frozen=True, eq=False):
    """An episode that is ready to be written."""

    episode: SourceEpisode
    """Without pictures."""
    frames: int
    stats: dict[str, Stats]
    content: dict[str, str]
    pngs: list[bytes] | None = None
    clip: bytes | None = None
    """An mp4; of `pngs` and this, one is there."""
    measured: dict[str, Any] = {}
    """Columns of `meta/episodes` that come from coding it."""


def prepare(episode: SourceEpisode, *, video: bool = False) -> Prepared:
    """Code, count and hash an episode; PNG files that it brings are taken over as they are."""
    images = episode.images
    if images is None:
        assert episode.pngs is not None
        images = np.stack([_decoded(data) for data in episode.pngs])
    pngs, clip, measured = episode.pngs, None, {}
    if video:
        pngs, clip, logged = None, encode_clip(images), images
        images = decode_clip(clip)
        measured = {PIXEL_ERROR + name: value for name, value in pixel_error(logged, images).items()}
    elif pngs is None:
        pngs = encode_pngs(images)
    stats = {name: feature_stats(values) for name, values in episode.numbers.items()}
    content = {name: feature_digest(values) for name, values in episode.numbers.items()}
    return Prepared(
        episode=msgspec.structs.replace(episode, images=None, pngs=None),
        frames=len(images),
        stats=stats | {IMAGE: picture_stats(images)},
        content=content | {IMAGE: feature_digest(images)},
        pngs=pngs,
        clip=clip,
        measured=measured,
    )


def _decoded(png: bytes) -> np.ndarray:
    try:
        return decode_untrusted(png)
    except ValueError as error:
        raise ArtefactError(f"a picture of a release: {error}; see which with `gym-open dataset verify`") from None
