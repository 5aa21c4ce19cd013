"""What decides a dataset release."""

from typing import Annotated, Literal

from msgspec import Meta

from gym_open.config import Config, Fraction, PositiveInt, Seed

Name = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9-]*/[a-z0-9][a-z0-9-]*$")]


class ReleaseConfig(Config, frozen=True):
    """Logs to a dataset release in LeRobot v3.0 layout."""

    name: Name = "open/explore-mini"
    """Namespace and name, as a hub would have it."""
    split_by: Literal["stream", "world"] = "world"
    """What train and val never share. Worlds are told apart by layout, over all streams."""
    val_fraction: Fraction = 0.1
    """Share of the worlds (or streams) set aside for val, rounded; with few of them that can be none."""
    max_episode_steps: PositiveInt = 1000
    """A longer segment becomes several episodes. Such a cut is no switch: `ended` says `length_cap`."""
    data_file_mb: PositiveInt = 100
    """A new data file is begun at this size in memory, in MiB; an episode is never torn."""
    seed: Seed = 0
    """Root seed; decides which worlds or streams are set aside."""
