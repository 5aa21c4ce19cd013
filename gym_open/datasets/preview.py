"""A preview of a release: a LeRobot v3.0 dataset with video that browsers play, for the online visualizer.

The visualizer shows only datasets whose images are video, and browsers do not play the lossless video of releases. So
a preview is a dataset of its own, with its own name on a hub. It is no release: it has no manifest and no replay.
"""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from gym_open import progress
from gym_open.artefacts import SCRATCH
from gym_open.datasets.config import Header
from gym_open.datasets.export import beside
from gym_open.datasets.writing.sources import SourceEpisode
from gym_open.datasets.writing.splits import Share
from gym_open.datasets.writing.video import BROWSER
from gym_open.datasets.writing.writer import ReleaseWriter
from gym_open.formats.releases import IMAGE, Release
from gym_open.formats.releases.features import Features, features, learned, objects
from gym_open.formats.releases.info import read_json
from gym_open.formats.releases.layout import BOOKKEEPING, CARD, INFO_PATH, LEARNED, PART, SPLITS, TABLES, Split
from gym_open.formats.releases.schemas import EPISODE_ROW
from gym_open.replay.compact import open_dataset


def export_preview(root: Path, out: Path, *, workers: int | None = None) -> Path:
    """Write the preview of the release or compact release at `root` as the folder `out`.

    Args:
        root: folder of either. Every byte of it is checked.
        out: folder to write.
        workers: number of threads; by default one per core.

    Raises:
        ArtefactError: if the release is damaged.
        UsageError: if `out` exists already.
    """
    release = open_dataset(root, check="bytes")
    rows = release.episodes
    shares: dict[Split, Share] = {split: Share() for split in SPLITS}
    for split, length in zip(rows["split"], rows["length"], strict=True):
        shares[split] = shares[split].plus(1, int(length))
    ours = release.info["gym_open"]
    header = Header(**{name: ours[name] for name in ("name", "version", "license", "published")})
    settings = {name: ours[name] for name in ("split_by", "val", "max_episode_steps")} | {"pictures": "video"}
    with beside(out) as partial, progress.bar("preview", int(rows["steps"].sum())) as bar:
        partial.mkdir()
        with ReleaseWriter(
            partial, header, _described(release.info["features"]), shares,
            ours=settings, data_file_mb=100, workers=workers, coding=BROWSER,
        ) as writer:  # fmt: skip
            for episode in _episodes(release):
                writer.add(episode)
                bar.advance(episode.row["steps"])
            writer.close({name: release.arrow_table(name) for name in ("streams", "worlds", "switches")})
        for name in (SCRATCH, *(f"meta/{name}" for name in TABLES)):
            shutil.rmtree(partial / name, ignore_errors=True)
        (partial / "meta/digests.json").unlink()
        (partial / CARD).write_text(_card(release, partial), encoding="utf-8")
        out.parent.mkdir(parents=True, exist_ok=True)
        partial.rename(out)
    return out


def _described(original: Features) -> Features:
    """The features of the release, with the image as video of double size."""
    parts = [name.removeprefix(PART) for name in original if name.startswith(PART)]
    left_out = [name for name in LEARNED if name not in learned(original)]
    described = features(objects(original), parts, "video", left_out)
    image = described[IMAGE]
    height, width = (BROWSER.scale * size for size in image["shape"][:2])
    coding = {"video.height": height, "video.width": width, "video.pix_fmt": BROWSER.pixels}
    image |= {"shape": [height, width, 3], "info": {**image["info"], **coding}}
    return described


def _episodes(release: Release) -> Iterator[SourceEpisode]:
    rows = release.episodes.to_dict("records")
    for episode in release.iterate_episodes():
        numbers = {name: values for name, values in episode.frames.items() if name not in BOOKKEEPING}
        plain = {name: rows[episode.id][name] for name, _ in EPISODE_ROW}
        yield SourceEpisode(numbers, plain, [], images=np.asarray(episode.observations))


def _card(release: Release, folder: Path) -> str:
    error = read_json(folder / INFO_PATH, dict)["gym_open"]["video_error"]
    frames = len(pd.read_parquet(folder / "data", columns=["index"]))
    psnr = "no error" if error["psnr"] is None else f"PSNR {error['psnr']:.1f} dB"
    return f"""\
---
license: {release.info["gym_open"]["license"]}
tags: [LeRobot, gym-open, preview]
---
# {release.name} {release.version}, preview

For looking at it in a browser: the {frames:,} frames of the release {release.name} {release.version} (content as its
`meta/digests.json` says) as H.264 video, yuv420p, {BROWSER.scale} pixels wide and high for each pixel of an image.

**Do not train on it.** Compared with the exact images, the levels of all pixels and channels are off by
{error["mean"]:.2f} of 255 on average and by {error["max"]:.0f} at most ({psnr}). The release has the exact images.
"""
