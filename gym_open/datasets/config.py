"""What decides a dataset release."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.config import Config, Fraction, PositiveInt, Seed, matching
from gym_open.formats.releases.layout import MAX_EPISODE_STEPS, Split

Name = Annotated[
    str, matching(r"^[a-z0-9][a-z0-9-]*/[a-z0-9][a-z0-9-]*$", "NAMESPACE/NAME of small letters, digits and -")
]
Version = Annotated[str, matching(r"^(0|[1-9]\d{0,5})\.(0|[1-9]\d{0,5})\.(0|[1-9]\d{0,5})$", "three numbers, as 1.0.0")]
Date = Annotated[str, matching(r"^(\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01]))?$", "a day, as 2026-11-21, or nothing")]
License = Literal["mit", "cc-by-4.0", "cc0-1.0"]
PuzzleDigest = Annotated[str, matching(r"^[0-9a-f]{6,64}$", "six hexadecimal digits or more")]


class Header(Config, frozen=True):
    """What every release says of itself, however it was made."""

    name: Name = "open/explore"
    """Namespace and name, as a hub would have it."""
    version: Version = "1.0.0"
    """Semantic version. Of two versions, the second must say what it did to the first."""
    license: License = "mit"
    """SPDX identifier of the licence, in small letters as on the hub."""
    published: Date = ""
    """Day of publication, YYYY-MM-DD, or nothing. No clock is ever read."""


class ReleaseConfig(Header, frozen=True):
    """Logs to a dataset release in LeRobot v3.0 layout."""

    split_by: Literal["stream", "world"] = "world"
    """What train and val never share. Worlds are told apart by layout, over all streams."""
    val_fraction: Fraction = 0.1
    """Share of the worlds (or streams) set aside for val, rounded; one at least of each where there are two."""
    max_episode_steps: Annotated[int, Meta(ge=1, le=MAX_EPISODE_STEPS)] = 1024
    """A longer segment becomes several episodes. Such a cut is no switch: `ended` says `length_cap`. A multiple of the
    logs' distance between keyframes makes every episode begin with one."""
    data_file_mb: PositiveInt = 100
    """A new data file is begun at this size in memory, in MiB; an episode is never torn."""
    pictures: Literal["png", "video"] = "png"
    """PNG files in parquet, bit for bit the logs', or H.264 video beside it: a third of the size, slower at random."""
    seed: Seed = 0
    """Root seed; decides which worlds or streams are set aside."""


class MergeConfig(Header, frozen=True):
    """Several releases to one."""

    data_file_mb: PositiveInt = 100
    """As in `ReleaseConfig`."""


class FilterConfig(Header, frozen=True):
    """Some episodes of a release to one of their own. An episode must meet every condition that is given."""

    explorer: tuple[str, ...] = ()
    """Names of explorers, as `icm` or `curl+ride`."""
    world: tuple[PuzzleDigest, ...] = ()
    """Digests of layouts, or the first six digits or more of them."""
    min_contact: Fraction = 0.0
    """Least share of the episode's steps in which the agent touches something."""
    min_coverage: Fraction = 0.0
    """Least share of the table's 5 cm cells that the agent visits in the episode."""
    split: tuple[Split, ...] = ()
    """Splits to take."""
    data_file_mb: PositiveInt = 100
    """As in `ReleaseConfig`."""
