"""Write the fixed puzzles: `python -m gym_open.envs.puzzles.make_sets FOLDER`.

The result has the same bytes on every machine. The sets are frozen; this script documents their origin.
"""

import hashlib
import sys
from pathlib import Path

from gym_open import seeding
from gym_open.artefacts import canonical_json
from gym_open.envs.puzzles.generators import draw_layout
from gym_open.envs.puzzles.puzzle import TASKS
from gym_open.envs.puzzles.sets import DIGESTS, PER_SET, SPLITS, set_name

SEED = 2021
"""The year of the paper."""


def set_bytes() -> dict[str, bytes]:
    """The files of all tasks and splits, by name: one puzzle per line, and no layout twice in any of them."""
    seen: set[str] = set()
    files: dict[str, bytes] = {}
    for split in SPLITS:
        for task in TASKS:
            rng = seeding.generator(SEED, f"{split}-puzzles", task)
            lines: list[bytes] = []
            while len(lines) < PER_SET:
                puzzle = draw_layout(task, rng)
                if puzzle.digest not in seen:
                    seen.add(puzzle.digest)
                    lines.append(puzzle.to_json() + b"\n")
            files[set_name(task, split)] = b"".join(lines)
    return files


def write_digests(folder: Path) -> None:
    """Write the SHA-256 of every file of puzzles and witnesses in `folder`."""
    files = sorted(folder.glob("*.jsonl"))
    digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    (folder / DIGESTS).write_bytes(canonical_json(digests))


if __name__ == "__main__":
    target = Path(sys.argv[1])
    for name, data in set_bytes().items():
        (target / name).write_bytes(data)
        print(f"{PER_SET} puzzles in {target / name}")
    write_digests(target)
