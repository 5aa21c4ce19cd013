"""Configurations of dataset releases."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.config import Config, Fraction, PositiveInt, Seed, matching
from gym_open.formats.releases.layout import MAX_EPISODE_STEPS, Split

Name = Annotated[
    str, matching(r"^[a-z0-9][a-z0-9-]*/[a-z0-9][a-z0-9-]*\Z", "NAMESPACE/NAME of small letters, digits and -")
]
Version = Annotated[
    str, matching(r"^(0|[1-9]\d{0,5})\.(0|[1-9]\d{0,5})\.(0|[1-9]\d{0,5})\Z", "three numbers, as 1.0.0")
]
Date = Annotated[
    str, matching(r"^(\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01]))?\Z", "a day, as 2026-11-21, or nothing")
]
License = Literal["mit", "cc-by-4.0", "cc0-1.0"]
PuzzleDigest = Annotated[str, matching(r"^[0-9a-f]{6,64}\Z", "six hexadecimal digits or more")]


class Header(Config, frozen=True):
    """Configuration that every release has, however it was made."""

    name: Name = "open/explore"
    """NAMESPACE/NAME, as on a hub."""
    version: Version = "1.0.0"
    """Semantic version. It must follow from what changed since the previous version."""
    license: License = "mit"
    """SPDX identifier of the licence in small letters, as on the hub."""
    published: Date = ""
    """Day of publication, YYYY-MM-DD, or nothing. It never comes from a clock."""


class ReleaseConfig(Header, frozen=True):
    """Configuration of a release that is built from logs."""

    split_by: Literal["stream", "world"] = "world"
    """What train and val never share. Two worlds are the same if their layouts are, also across streams."""
    val_fraction: Fraction = 0.1
    """Share of the worlds (or streams) in val, rounded. If there are two or more, each split has at least one."""
    max_episode_steps: Annotated[int, Meta(ge=1, le=MAX_EPISODE_STEPS)] = 1024
    """A longer segment becomes several episodes. Such a cut is no switch: `ended` is `length_cap`. With a multiple of
    the logs' distance between keyframes, every episode begins with a keyframe."""
    data_file_mb: PositiveInt = 100
    """Size in memory, in MiB, at which a new data file begins. An episode is never split between files."""
    pictures: Literal["png", "video"] = "png"
    """Images as PNG in parquet, identical to the logs', or as H.264 video: a third of the size, but slower."""
    seed: Seed = 0
    """Root seed. It determines which worlds or streams are in val."""


class MergeConfig(Header, frozen=True):
    """Configuration of a release that is merged from several releases."""

    data_file_mb: PositiveInt = 100
    """As in `ReleaseConfig`."""


class FilterConfig(Header, frozen=True):
    """Configuration of a release of selected episodes. An episode must meet every given condition."""

    explorer: tuple[str, ...] = ()
    """Names of explorers, such as `icm` or `curl+ride`."""
    world: tuple[PuzzleDigest, ...] = ()
    """Digests of layouts, or their first six or more digits."""
    min_contact: Fraction = 0.0
    """Smallest share of an episode's steps in which the agent touches something."""
    min_coverage: Fraction = 0.0
    """Smallest share of the table's 5 cm cells that the agent visits in an episode."""
    split: tuple[Split, ...] = ()
    """Splits to select."""
    leave_out: tuple[str, ...] = ()
    """Features with the explorer's own values that the result does not have, or `explorer` for all of them."""
    data_file_mb: PositiveInt = 100
    """As in `ReleaseConfig`."""
