"""Files and rows of a compact release: `gym-open-compact/1`. See docs/compact-format.md."""

import re
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from gym_open.formats.releases.layout import MAX_EPISODE_STEPS, Split

FORMAT = "gym-open-compact/1"
INFO, CARD = "compact.json", "README.md"
ACTIONS, EPISODES, STATES = "actions.zst", "episodes.jsonl.zst", "states.jsonl.zst"
STREAMS, WORLDS, SWITCHES = "streams.jsonl.zst", "worlds.jsonl.zst", "switches.jsonl.zst"
COLUMNS, LOSSES = "columns/", "columns/switches.world_losses.zst"
RELEASE = "release/"
"""Folder with the release's own documents and records, byte for byte. Its data, videos and tables are not there."""

MAX_COUNT = 2**40
_Number = Annotated[int, Meta(ge=0, le=MAX_COUNT)]
_Digest = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]
_Text = Annotated[str, Meta(max_length=200)]
_MEMBER = re.compile(
    r"(?:config|lineage|manifest|compact)\.json|README\.md|(?:actions|(?:episodes|states|streams|worlds|switches)\.jsonl)"
    r"\.zst|columns/[A-Za-z0-9_.-]+\.zst|release/.+",
    re.ASCII,
)


class _Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A row of a table, or a record."""


class CompactInfo(_Row, frozen=True):
    """`compact.json`: which release this is, and how much of it there is."""

    format: _Text
    name: _Text
    version: _Text
    release: _Digest
    """Digest of the artefact that was packed."""
    payload: _Digest
    content: _Digest
    """Its payload digest and its content digest."""
    episodes: _Number
    steps: _Number
    columns: list[_Text]
    """Features with the explorer's own values, each in a file of `columns/`."""


class StreamRow(_Row, frozen=True):
    """A stream, as in the release's table `streams`, with its batch."""

    batch: Annotated[int, Meta(ge=0, le=999)]
    stream: _Number
    log: _Number
    log_stream: _Number
    explorer: _Text
    steps: _Number
    seed: _Text
    config: str


class WorldPlace(_Row, frozen=True, array_like=True):
    """A world of a stream's pool that has a layout, and its split if it was visited."""

    stream: _Number
    world: _Number
    split: Split | None


class WorldRow(_Row, frozen=True):
    """A layout, and all worlds that have it."""

    puzzle: str
    """The layout as JSON."""
    places: list[WorldPlace]


class SwitchRow(_Row, frozen=True):
    """A switch, as in the release's table, without the losses of the worlds."""

    stream: _Number
    step: _Number
    from_world: Annotated[int, Meta(ge=-1, le=MAX_COUNT)]
    to_world: Annotated[int, Meta(ge=-1, le=MAX_COUNT)]
    reason: _Text
    losses: Annotated[int, Meta(ge=0, le=10_000_000)] = 0
    """Number of losses in `LOSSES`."""


Start = Literal["layout", "episode", "world", "state"]
"""First state of an episode: the world's layout, the end of the stream's episode before, the state in which the stream
last left this world, or the next row of `STATES`."""


class EpisodeRow(_Row, frozen=True):
    """An episode: what its row in `meta/episodes` says, how to begin it, and the digest of its content."""

    batch: Annotated[int, Meta(ge=0, le=999)]
    stream: _Number
    segment: _Number
    piece: _Number
    world: _Number
    first_step: _Number
    steps: Annotated[int, Meta(ge=0, le=MAX_EPISODE_STEPS)]
    continued: bool
    ended: _Text
    split: Split
    start: Start
    keyframes: Annotated[list[int], Meta(max_length=MAX_EPISODE_STEPS + 1)]
    """Frames with a stored state in the release's table `keyframes`."""
    digest: _Digest
    """Content digest of the episode."""


class StateRow(_Row, frozen=True, array_like=True):
    """A state of the simulation that no simulation of this release reaches: integration state, float64."""

    values: Annotated[list[float], Meta(max_length=100_000)]


def belongs(name: str) -> bool:
    """Whether a compact release may hold a file with this name."""
    return _MEMBER.fullmatch(name) is not None and ".." not in name.split("/")


def column_path(feature: str) -> str:
    """Name of the file with the values of a feature."""
    return f"{COLUMNS}{feature}.zst"
