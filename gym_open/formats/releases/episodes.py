"""One episode of a release as arrays."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class EpisodeData:
    """One episode: T actions and T + 1 observations.

    Raises:
        ValueError: if the arrays do not have these lengths.
    """

    id: int
    """Its `episode_index`: the row of `Release.episodes`."""
    observations: np.ndarray
    """Images, (T + 1, 84, 84, 3) uint8 RGB."""
    actions: np.ndarray
    """(T,) int64."""
    rewards: np.ndarray
    """Intrinsic rewards, (T,) float32; NaN if the release leaves them out."""
    frames: dict[str, np.ndarray]
    """Every numeric feature by name, T + 1 rows each; see docs/release-format.md."""

    def __post_init__(self) -> None:
        steps = len(self.actions)
        if len(self.observations) != steps + 1:
            raise ValueError(
                "expected one more observation than actions: got "
                f"{len(self.observations)} observations and {steps} actions"
            )
        if len(self.rewards) != steps:
            raise ValueError(f"expected one reward per action: got {len(self.rewards)} rewards and {steps} actions")
        if odd := [name for name, values in self.frames.items() if len(values) != steps + 1]:
            raise ValueError(f"expected {steps + 1} rows of every feature: {odd[0]} has {len(self.frames[odd[0]])}")
