"""Reader of `meta/info.json` that refuses every value which a release of this format cannot have."""

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from gym_open.errors import ArtefactError
from gym_open.formats.releases.layout import (
    CODEBASE_VERSION,
    DATA_TEMPLATE,
    FORMAT,
    INFO_PATH,
    LEARNED,
    MAX_FILES,
    PART,
    VIDEO_TEMPLATE,
)

MAX_JSON_BYTES = 2**26
"""Larger JSON files are refused. The largest JSON file of a release with 2 million steps has 100 kB."""
_MAX_COUNT = 2**40

Count = Annotated[int, Meta(ge=1, le=_MAX_COUNT)]
Text = Annotated[str, Meta(max_length=200)]
_NAMESPACED = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9-]*/[a-z0-9][a-z0-9-]*\Z", max_length=200)]
_SEMVER = Annotated[str, Meta(pattern=r"^(0|[1-9]\d{0,5})\.(0|[1-9]\d{0,5})\.(0|[1-9]\d{0,5})\Z", max_length=20)]
_DAY = Annotated[str, Meta(pattern=r"^(\d{4}-\d\d-\d\d)?\Z", max_length=10)]
_THING = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_:.-]+\Z", max_length=100)]


class _VideoError(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Error of all pixels against the logged ones, in levels of 255; PSNR in dB, None without any error."""

    mean: Annotated[float, Meta(ge=0, le=255)]
    max: Annotated[float, Meta(ge=0, le=255)]
    psnr: Annotated[float, Meta(ge=0, le=1000)] | None


class _GymOpenInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Our own part of `meta/info.json`."""

    format: Text
    name: _NAMESPACED
    version: _SEMVER
    license: Text
    published: _DAY
    split_by: Literal["stream", "world"]
    val: Annotated[list[Text], Meta(max_length=100_000)]
    max_episode_steps: Count
    objects: Annotated[list[_THING], Meta(min_length=1, max_length=1000)]
    pictures: Literal["png", "video"]
    batches: Annotated[int, Meta(ge=1, le=MAX_FILES)]
    video_error: _VideoError | msgspec.UnsetType = msgspec.UNSET


class _ReleaseInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    codebase_version: Text
    robot_type: Text
    total_episodes: Count
    total_frames: Count
    total_tasks: Annotated[int, Meta(ge=1, le=1)]
    chunks_size: Annotated[int, Meta(ge=1, le=MAX_FILES)]
    data_files_size_in_mb: Count
    video_files_size_in_mb: Count
    fps: float
    splits: Annotated[dict[Text, Annotated[str, Meta(max_length=10_000_000)]], Meta(max_length=10)]
    data_path: Text
    video_path: Text | None
    features: Annotated[dict[Text, Any], Meta(max_length=1000)]
    gym_open: _GymOpenInfo


def read_json(path: Path, kind: Any) -> Any:
    """Read a JSON file of a release as the type `kind`.

    Raises:
        ArtefactError: if it is missing, a link, too large, nested too deeply, or not of that type.
    """
    try:
        if path.is_symlink() or not path.is_file():
            raise ArtefactError(f"{path}: missing, or a link; get the release again")
        if (size := path.stat().st_size) > MAX_JSON_BYTES:
            raise ArtefactError(f"{path}: {size:,} bytes, the limit is {MAX_JSON_BYTES:,}; get the release again")
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; build the release again") from None


def read_info(root: Path) -> dict[str, Any]:
    """Read `meta/info.json` of the release at `root` and check every field.

    Raises:
        ArtefactError: names the field, the expected value and the found value.
    """
    path = root / INFO_PATH
    raw = read_json(path, dict[str, Any])
    ours = raw.get("gym_open")
    for field, expected, found in (
        ("codebase_version", CODEBASE_VERSION, raw.get("codebase_version")),
        ("gym_open.format", FORMAT, ours.get("format") if isinstance(ours, dict) else None),
    ):
        if found != expected:
            raise ArtefactError(f"{path}: {field} must be {expected!r}, got {str(found)[:100]!r}; build it again")
    try:
        info = msgspec.convert(raw, _ReleaseInfo, strict=True)
    except msgspec.ValidationError as error:
        raise ArtefactError(f"{path}: {error}; build the release again") from None
    _check(path, info)
    return raw


def _check(path: Path, info: _ReleaseInfo) -> None:
    """Raises ArtefactError if a field contradicts the others."""
    from gym_open.formats.releases.features import features, fps

    video = info.gym_open.pictures == "video"
    parts = [name.removeprefix(PART) for name in info.features if name.startswith(PART)]
    left_out = [name for name in LEARNED if name not in info.features]
    described = features(info.gym_open.objects, parts, info.gym_open.pictures, left_out)
    expected = {
        "data_path": DATA_TEMPLATE,
        "video_path": VIDEO_TEMPLATE if video else None,
        "fps": fps(),
        "chunks_size": MAX_FILES,
        "robot_type": "gym-open",
    }
    for field, wanted in expected.items():
        if (found := getattr(info, field)) != wanted:
            raise ArtefactError(f"{path}: {field} must be {wanted!r}, got {found!r}; no other value is allowed")
    for name in sorted(info.features.keys() | described.keys()):
        if info.features.get(name) != described.get(name):
            raise ArtefactError(
                f"{path}: feature {name!r} must be {described.get(name)!r} for these objects and pictures, got "
                f"{str(info.features.get(name))[:200]}; build the release again"
            )
    if info.total_episodes > info.total_frames:
        raise ArtefactError(
            f"{path}: {info.total_episodes:,} episodes of at least one frame do not fit into "
            f"{info.total_frames:,} frames; build the release again"
        )


def split_ranges(splits: Iterable[str]) -> dict[str, str]:
    """Ranges of episodes per split in LeRobot's form: "0:10", or "0:10,14:20" after an append.

    Args:
        splits: the split of every episode, in order.
    """
    found: dict[str, list[str]] = {}
    first = 0
    for split, group in groupby(splits):
        stop = first + len(list(group))
        found.setdefault(split, []).append(f"{first}:{stop}")
        first = stop
    return {split: ",".join(parts) for split, parts in found.items()}
