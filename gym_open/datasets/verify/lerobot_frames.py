"""Load some frames of a release as users do, with LeRobot: `python -P FILE ROOT NAME OUT EPISODE…`.

This runs in a separate process: off-line from the first import, and with a temporary cache. If a library crashes, only
this process ends. It needs only NumPy and LeRobot, so LeRobot's environment may lack gym-open.
"""

import sys
from pathlib import Path

import numpy as np


def main(root: str, name: str, out: str, *episodes: str) -> None:
    """Write the first and last frame of some episodes, with all numbers and the image, to an npz file."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    found: dict[str, np.ndarray] = {}
    for episode in map(int, episodes):
        dataset = LeRobotDataset(name, root=Path(root), episodes=[episode], video_backend="pyav")
        found[f"{episode}/total"] = np.array([dataset.meta.total_episodes, dataset.meta.total_frames])
        found[f"{episode}/length"] = np.array([len(dataset)])
        for place, index in (("first", 0), ("last", len(dataset) - 1)):
            for feature in dataset.meta.features:
                found[f"{episode}/{place}/{feature}"] = dataset[index][feature].numpy()
    np.savez(out, **found)  # pyright: ignore[reportArgumentType]  # pyright takes an option of savez for an array


if __name__ == "__main__":
    main(*sys.argv[1:])
