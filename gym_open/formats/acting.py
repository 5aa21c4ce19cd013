"""What a policy makes of what it sees, and how its actions are drawn: the same for who scores it and who views it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gym_open.envs.puzzles import Task
from gym_open.seeding import generator

Judge = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From images (B, 84, 84, 3) uint8, or states (B, `STATE_SIZE`) float32, to action probabilities (B, 9) float64 and
values (B,) float32."""


def load_judge(folder: Path, threads: int) -> tuple[Judge, bool]:
    """The policy in a folder, and whether it sees states in place of pictures.

    Args:
        folder: of a policy, or of one of its checkpoints.
        threads: of this process, to share pictures out among.

    Raises:
        ArtefactError: if a file is missing or damaged.
    """
    import torch

    from gym_open.agents.threads import set_threads
    from gym_open.formats.models import load_policy

    set_threads(threads)
    network = load_policy(folder).eval()

    @torch.inference_mode()
    def judge(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        logits, values = network(network.prepare(torch.from_numpy(seen)))
        return torch.softmax(logits.double(), dim=1).numpy(), values.numpy()

    return judge, network.encoder.config.architecture == "state"


def action_generator(seed: int, task: Task, index: int) -> np.random.Generator:
    """What the actions of an evaluation with root seed `seed` are drawn from in the fixed puzzle with this index."""
    return generator(seed, "evaluate", task, index)


def draw_action(probabilities: np.ndarray, rng: np.random.Generator) -> int:
    """An action, drawn with these probabilities (9,) float64."""
    edges = np.cumsum(probabilities)
    return min(int(np.searchsorted(edges, rng.random() * edges[-1], side="right")), len(edges) - 1)
