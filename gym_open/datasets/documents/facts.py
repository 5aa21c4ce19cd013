"""Facts about a release, counted from its data, from which the card, the figures and `rebuild/` are written.

Numbers are read from one data file at a time, only the necessary columns. Images are not read.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gym_open.envs.constants import N_ACTIONS, WALL_X, WALL_Y
from gym_open.errors import ArtefactError
from gym_open.formats.releases import Release, features, parquet
from gym_open.formats.releases.layout import DATA_PATHS, LEARNED, PART, SPLITS
from gym_open.formats.releases.schemas import table_schema

if TYPE_CHECKING:
    import pandas as pd

CELL_M = 0.05
"""Edge length of the squares in which the positions of the agent are counted."""
X_EDGES = np.arange(-np.ceil(WALL_X / CELL_M), np.ceil(WALL_X / CELL_M) + 1) * CELL_M
Y_EDGES = np.arange(-np.ceil(WALL_Y / CELL_M), np.ceil(WALL_Y / CELL_M) + 1) * CELL_M
"""Edges of the squares in metres, from wall to wall."""


@dataclass(frozen=True)
class ValueRange:
    """Range of the finite values of a feature."""

    finite: float
    """Share of actions with a finite value."""
    low: float
    median: float
    mean: float
    high: float


@dataclass
class ExplorerFacts:
    """Facts about the exploration of one explorer."""

    explorer: str
    episodes: int
    frames: int
    steps: int
    streams: int
    worlds: int
    """Distinct layouts."""
    lengths: np.ndarray
    """Steps of each episode."""
    ended: Counter[str]
    actions: np.ndarray = field(default_factory=lambda: np.zeros(N_ACTIONS, dtype=np.int64))
    """How often each action was taken."""
    touching: int = 0
    """Number of steps in which the agent touched something."""
    visits: np.ndarray = field(default_factory=lambda: np.zeros((len(Y_EDGES) - 1, len(X_EDGES) - 1), dtype=np.int64))
    """Number of frames in each square (from −y to +y, from −x to +x)."""
    ranges: dict[str, ValueRange] = field(default_factory=dict)
    """Ranges of the explorer's values for its steps, by feature."""

    def share(self, steps: int) -> float:
        """A number of steps as a share of all its steps."""
        return steps / max(self.steps, 1)


@dataclass(frozen=True)
class LogFacts:
    """Facts about one log in the release."""

    number: int
    """Number of the log in its build, in the order in which the logs were given."""
    batch: int
    """Number of its build: 0 for the first one, 1 for the first append."""
    explorer: str
    config: Mapping[str, Any]
    streams: int
    steps: int

    @property
    def curriculum(self) -> object:
        """Name of the curriculum rule, which decides when a stream leaves its world."""
        section = self.config.get("curriculum")
        return section.get("rule", "–") if isinstance(section, Mapping) else "–"


@dataclass(frozen=True)
class SplitFacts:
    """Facts about a split."""

    episodes: int
    frames: int
    steps: int
    worlds: int
    chunks: tuple[int, ...]
    """Numbers of the folders of its data files."""


@dataclass(frozen=True)
class ReleaseFacts:
    """All facts about a release."""

    release: Release
    explorers: list[ExplorerFacts]
    """In the order of their names."""
    logs: list[LogFacts]
    splits: dict[str, SplitFacts]
    data_bytes: int

    @property
    def steps(self) -> int:
        """Number of all actions."""
        return sum(one.steps for one in self.explorers)

    @property
    def ended(self) -> Counter[str]:
        """How often episodes ended for each reason."""
        return sum((one.ended for one in self.explorers), Counter[str]())


def gather(release: Release) -> ReleaseFacts:
    """Count the contents of a release, which may still be unsealed.

    Raises:
        ArtefactError: if a configuration in the release is not JSON, or a file is damaged.
    """
    episodes = release.episodes
    names = sorted(episodes["explorer"].unique())
    explorers = [_episodes_of(name, episodes[episodes["explorer"] == name]) for name in names]
    owner = episodes["explorer"].map({name: i for i, name in enumerate(names)}).to_numpy()
    _read_frames(release, explorers, owner)
    splits = {name: _split(episodes[episodes["split"] == name]) for name in SPLITS}
    size = sum(path.stat().st_size for folder in ("data", "videos") for path in (release.root / folder).rglob("*.*"))
    return ReleaseFacts(release, explorers, list(_logs(release)), splits, size)


def _episodes_of(explorer: str, rows: "pd.DataFrame") -> ExplorerFacts:
    return ExplorerFacts(
        explorer=explorer,
        episodes=len(rows),
        frames=int(rows["length"].sum()),
        steps=int(rows["steps"].sum()),
        streams=rows["stream"].nunique(),
        worlds=rows["puzzle"].nunique(),
        lengths=rows["steps"].to_numpy(),
        ended=Counter(rows["ended"]),
    )


def _split(rows: "pd.DataFrame") -> SplitFacts:
    return SplitFacts(
        episodes=len(rows),
        frames=int(rows["length"].sum()),
        steps=int(rows["steps"].sum()),
        worlds=rows["puzzle"].nunique(),
        chunks=tuple(sorted({int(chunk) for chunk in rows["data/chunk_index"]})),
    )


def _read_frames(release: Release, explorers: list[ExplorerFacts], owner: np.ndarray) -> None:
    """Count the frames of each explorer. `owner` holds, for each episode, the number of its explorer in `explorers`."""
    described = release.info["features"]
    thought = [name for name in LEARNED if name in described]
    thought += sorted(name for name in described if name.startswith(PART))
    columns = ["episode_index", "action.index", "contact.agent", "transition.valid", "observation.state", *thought]
    schema = features.schema(described)
    values: list[dict[str, list[np.ndarray]]] = [{name: [] for name in thought} for _ in explorers]
    for path in sorted(release.root.glob(DATA_PATHS)):
        frames = parquet.read(path, schema, columns).combine_chunks()
        column = {name: frames.column(name).to_numpy() for name in columns if name != "observation.state"}
        places = frames.column("observation.state").combine_chunks().flatten().to_numpy().reshape(len(frames), -1)
        explorer = owner[column["episode_index"]]
        for number, one in enumerate(explorers):
            own = explorer == number
            x, y = places[own, :2].T
            one.visits += np.histogram2d(y, x, bins=(Y_EDGES, X_EDGES))[0].astype(np.int64)
            steps = own & column["transition.valid"]
            one.actions += np.bincount(column["action.index"][steps], minlength=N_ACTIONS)
            one.touching += int((column["contact.agent"][steps] > 0).sum())
            for name in thought:
                values[number][name].append(column[name][steps])
    for one, found in zip(explorers, values, strict=True):
        one.ranges = {name: _range(np.concatenate(parts)) for name, parts in found.items()}


def _range(values: np.ndarray) -> ValueRange:
    finite = values[np.isfinite(values)].astype(np.float64)
    if not finite.size:
        return ValueRange(0.0, np.nan, np.nan, np.nan, np.nan)
    share = finite.size / values.size
    return ValueRange(share, finite.min(), float(np.median(finite)), finite.mean(), finite.max())


def _logs(release: Release) -> Iterator[LogFacts]:
    schema = table_schema("streams", release.info["features"])
    for batch, path in enumerate(sorted(release.root.glob("meta/streams/file-*.parquet"))):
        streams: dict[tuple[int, str], list[dict[str, Any]]] = {}
        for row in parquet.read(path, schema).to_pylist():
            streams.setdefault((row["log"], row["config"]), []).append(row)
        for (number, config), rows in streams.items():
            steps = sum(row["steps"] for row in rows)
            yield LogFacts(number, batch, rows[0]["explorer"], _config(config, path, number), len(rows), steps)


def _config(text: str, path: Path, number: int) -> dict[str, Any]:
    try:
        return msgspec.json.decode(text, type=dict[str, Any])
    except (msgspec.DecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: configuration of log {number}: {error}; do not use this release") from None
