"""Names of what a release is made of."""

from typing import Literal

IMAGE = "observation.image"
"""Feature that holds the picture; all others are numbers."""

INFO_PATH, STATS_PATH, TASKS_PATH = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
CODEBASE_VERSION = "v3.0"

Table = Literal["streams", "worlds", "switches", "segments"]
"""Tables of our own beside LeRobot's: `meta/<name>.parquet`."""
