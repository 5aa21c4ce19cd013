"""Plan a witness for each fixed puzzle, and write them: `python -m gym_open.envs.make_witnesses FOLDER`.

The same physics gives the same bytes. This takes about a minute.
"""

import sys
from pathlib import Path

from gym_open import progress
from gym_open.envs.planner import Solution, plan
from gym_open.envs.puzzles import TASKS
from gym_open.envs.puzzles.make_sets import write_digests
from gym_open.envs.puzzles.sets import PER_SET, SPLITS, puzzles_of
from gym_open.envs.puzzles.witnesses import witness_bytes, witness_name
from gym_open.envs.world import World


def main(folder: Path) -> None:
    """Write the witnesses of all sets and the digests of all files to `folder`."""
    world = World()
    plans: list[Solution] = []
    for task in TASKS:
        for split in SPLITS:
            with progress.bar(f"{task} {split}", PER_SET) as bar:
                for puzzle in puzzles_of(task, split):
                    plans.append(plan(puzzle, world))
                    bar.advance()
            name = witness_name(task, split)
            (folder / name).write_bytes(witness_bytes(task, split, [found.actions for found in plans[-PER_SET:]]))
    write_digests(folder)
    print(f"{len(plans)} witnesses in {folder}, {sum(found.robust for found in plans)} of them robust")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
