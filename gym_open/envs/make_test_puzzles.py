"""Write the fixed test puzzles: `python -m gym_open.envs.make_test_puzzles FOLDER`.

The same bytes come out on every machine. The sets are frozen: this stays as the proof of where they come from.
"""

import sys
from pathlib import Path

from gym_open import seeding
from gym_open.envs.generators import draw_layout
from gym_open.envs.puzzles import TASKS, Task
from gym_open.envs.test_set import PER_TASK

SEED = 2021
"""Year of the paper."""


def test_set_bytes() -> dict[Task, bytes]:
    """The file of each task: one puzzle a line, no layout twice over all tasks."""
    seen: set[str] = set()
    files: dict[Task, bytes] = {}
    for task in TASKS:
        rng = seeding.generator(SEED, "test-puzzles", task)
        lines: list[bytes] = []
        while len(lines) < PER_TASK:
            puzzle = draw_layout(task, rng)
            if puzzle.digest not in seen:
                seen.add(puzzle.digest)
                lines.append(puzzle.to_json() + b"\n")
        files[task] = b"".join(lines)
    return files


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for name, data in test_set_bytes().items():
        (folder / f"{name}.jsonl").write_bytes(data)
        print(f"{name}: {PER_TASK} puzzles in {folder / f'{name}.jsonl'}")
