"""Where do tool-use episodes end: in the pen, or on the way from it to the goal?

    .venv/bin/python benchmarks/study_tool_use.py SCORES_FOLDER [...]

The script replays every recorded episode, and records when the agent is first outside its pen and when it touches the
goal. It accepts scores of random actions and of the oracle, too.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from gym_open import progress
from gym_open.envs import constants as c
from gym_open.envs.env import OpenEnv
from gym_open.formats.scores import read_episodes
from gym_open.replay.episodes import replay_puzzle


def first_steps(scores: Path, puzzle: str) -> tuple[float, float]:
    """Numbers of actions until the agent was first outside its pen, and until it touched the goal; infinity: never."""
    places: list[np.ndarray] = []

    def see(env: OpenEnv, _image: np.ndarray, _info: dict[str, Any]) -> None:
        places.append(env.world.object_state()[0, :2].copy())

    played = replay_puzzle(scores, puzzle, see)
    pen = played.puzzle.pen
    assert pen is not None, f"{scores}: these are no scores of tool-use"
    outside = np.abs(np.array(places) - c.cell_centre(pen.row, pen.column)).max(axis=1) > c.PEN_HALF
    return (
        float(outside.argmax()) if outside.any() else np.inf,
        float(len(played.actions)) if sum(played.rewards) else np.inf,
    )


def main() -> None:
    """Print one row per scores artefact."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", type=Path, nargs="+")
    table = Table(
        "scores", "out ≤ 20", "out ≤ 50", "out ≤ 200", "median exit", "goal, of those out", "median from exit to goal"
    )
    for scores in parser.parse_args().scores:
        ids = [row["puzzle"] for row in read_episodes(scores)]
        with progress.bar(scores.name, len(ids)) as bar:
            found = []
            for puzzle in ids:
                found.append(first_steps(scores, puzzle))
                bar.advance(1)
        out, goal = np.array(found).T
        left, arrived = np.isfinite(out), np.isfinite(goal)
        shares = [f"{np.mean(out <= steps):.2f}" for steps in (20, 50, 200)]
        both = left & arrived
        table.add_row(
            scores.name, *shares, f"{np.median(out[left]):.0f}" if left.any() else "–",
            f"{arrived[left].mean():.2f}" if left.any() else "–",
            f"{np.median(goal[both] - out[both]):.0f}" if both.any() else "–",
        )  # fmt: skip
    Console().print(table)


if __name__ == "__main__":
    main()
