"""Loads some frames of a release as users do, with plain LeRobot: `python -P FILE ROOT NAME OUT EPISODE…`.

A process of its own: off-line from the first import on, with a cache that is thrown away, and if a library falls over
what it reads, only this process does. It needs NumPy and LeRobot alone, so LeRobot's environment may lack gym-open.
"""

import sys
from pathlib import Path

import numpy as np


def main(root: str, name: str, out: str, *episodes: str) -> None:
    """Write the first and the last frame of some episodes, all numbers of them and the picture, to an npz file."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    found: dict[str, np.ndarray] = {}
    for episode in map(int, episodes):
        dataset = LeRobotDataset(name, root=Path(root), episodes=[episode], video_backend="pyav")
        found[f"{episode}/total"] = np.array([dataset.meta.total_episodes, dataset.meta.total_frames])
        found[f"{episode}/length"] = np.array([len(dataset)])
        for place, index in (("first", 0), ("last", len(dataset) - 1)):
            for feature in dataset.meta.features:
                found[f"{episode}/{place}/{feature}"] = dataset[index][feature].numpy()
    np.savez(out, **found)  # pyright: ignore[reportArgumentType]  # NumPy takes its own option for an array


if __name__ == "__main__":
    main(*sys.argv[1:])
