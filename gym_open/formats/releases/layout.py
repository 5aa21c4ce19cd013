"""Names of files and tables of a release: `gym-open-release/2`, a LeRobot v3.0 folder with tables of our own."""

import re
from typing import Literal, get_args

FORMAT = "gym-open-release/2"
CODEBASE_VERSION = "v3.0"
"""LeRobot's version of its layout."""

IMAGE = "observation.image"
"""Feature that holds the image; all other features are numbers."""
PART = "reward_part."
"""Prefix of the features that hold a part of the intrinsic reward; the part's name follows."""
LEARNED = ("reward.intrinsic", "world_model.loss", "policy.entropy", "policy.value")
"""Features with the explorer's own values. A simulation cannot give them back, and a release may leave them out."""
BOOKKEEPING = ("index", "episode_index", "task_index")
"""Features that only number frames, episodes and tasks; they do not belong to the content."""

MAX_EPISODE_STEPS = 51_199
"""LeRobot needs times exact to 0.1 ms, which float32 gives up to 2,048 s. The limit also bounds memory."""

Split = Literal["train", "val"]
SPLITS: tuple[Split, ...] = get_args(Split)
"""In the order in which a batch holds them."""
Table = Literal["streams", "worlds", "switches", "segments", "keyframes", "content"]
TABLES: tuple[Table, ...] = get_args(Table)
"""Our own tables, in addition to LeRobot's: the files of `meta/<name>`."""

INFO_PATH, STATS_PATH, TASKS_PATH = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
DIGESTS_PATH = "meta/digests.json"
EPISODES_PATHS = "meta/episodes/chunk-000/file-*.parquet"
DATA_PATHS, VIDEO_PATHS = "data/chunk-*/file-*.parquet", f"videos/{IMAGE}/chunk-*/file-*.mp4"
DATA_TEMPLATE = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_TEMPLATE = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
"""Templates from which LeRobot makes file names. Our reader accepts no other template."""
MAX_FILES = 1000
"""Greatest number of files per folder and of such folders: their numbers have three digits."""

CARD, LICENSE, CHANGELOG, CROISSANT = "README.md", "LICENSE", "CHANGELOG.md", "croissant.json"
PROVENANCE, SIGNATURE = "provenance.json", "signature.json"
RECORDS = ("config.json", "lineage.json", "manifest.json", PROVENANCE)
"""Files that say which code, packages and inputs made a release. All other files are its payload."""

_NUMBERED = r"chunk-\d{3}/file-\d{3}"
_MEMBER = re.compile(
    "|".join(
        [
            *map(re.escape, (*RECORDS, SIGNATURE, CARD, LICENSE, CHANGELOG, CROISSANT)),
            *map(re.escape, (INFO_PATH, STATS_PATH, TASKS_PATH, DIGESTS_PATH)),
            rf"data/{_NUMBERED}\.parquet",
            rf"videos/{re.escape(IMAGE)}/{_NUMBERED}\.mp4",
            r"meta/episodes/chunk-000/file-\d{3}\.parquet",
            rf"meta/(?:{'|'.join(TABLES)})/file-\d{{3}}\.parquet",
            r"figures/[a-z0-9][a-z0-9_-]*\.png",
            r"rebuild/(?:rebuild\.sh|[a-z0-9][a-z0-9_-]*\.toml)",
        ]
    ),
    re.ASCII,
)


def belongs(name: str) -> bool:
    """Whether a release may hold a file with this name, relative to its folder and with forward slashes."""
    return _MEMBER.fullmatch(name) is not None


def data_path(chunk: int, file: int) -> str:
    """Name of a data file."""
    return DATA_TEMPLATE.format(chunk_index=chunk, file_index=file)


def video_path(chunk: int, file: int) -> str:
    """Name of the video that belongs to the data file with the same numbers."""
    return VIDEO_TEMPLATE.format(video_key=IMAGE, chunk_index=chunk, file_index=file)


def episodes_path(batch: int) -> str:
    """Name of the file with the rows of a batch in `meta/episodes`."""
    return f"meta/episodes/chunk-000/file-{batch:03d}.parquet"


def table_path(name: Table, batch: int) -> str:
    """Name of the file with the rows of a batch in one of our tables."""
    return f"meta/{name}/file-{batch:03d}.parquet"
