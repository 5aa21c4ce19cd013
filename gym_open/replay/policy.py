"""A policy's action probabilities, and how actions are drawn from them: the same for scoring and for viewing."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gym_open.envs.puzzles import Task
from gym_open.seeding import generator

PolicyFunction = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From images (B, 84, 84, 3) uint8, or simulator states (B, `STATE_SIZE`) float32, to action probabilities (B, 9)
float64 and values (B,) float32."""


def load_policy_function(folder: Path, threads: int) -> tuple[PolicyFunction, bool]:
    """Return the policy in a folder, and whether it sees the simulator state instead of images.

    Args:
        folder: of a policy, or of one of its checkpoints.
        threads: number of threads of this process that evaluate the network.

    Raises:
        ArtefactError: if a file is missing or damaged.
    """
    import torch

    from gym_open.agents.threads import set_threads
    from gym_open.formats.models import load_policy

    set_threads(threads)
    network = load_policy(folder).eval()

    @torch.inference_mode()
    def evaluate(observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        logits, values = network(network.prepare(torch.from_numpy(observations)))
        return torch.softmax(logits.double(), dim=1).numpy(), values.numpy()

    return evaluate, network.encoder.config.architecture == "state"


def action_generator(seed: int, task: Task, index: int) -> np.random.Generator:
    """Return the generator that draws the actions on one fixed puzzle in an evaluation with root seed `seed`."""
    return generator(seed, "evaluate", task, index)


def draw_action(probabilities: np.ndarray, rng: np.random.Generator) -> int:
    """Draw an action with these probabilities, (9,) float64."""
    edges = np.cumsum(probabilities)
    return min(int(np.searchsorted(edges, rng.random() * edges[-1], side="right")), len(edges) - 1)
