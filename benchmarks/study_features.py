"""Does a policy still use its observations? State of its encoder's features while PPO learns, at every checkpoint.

    .venv/bin/python benchmarks/study_features.py POLICY_FOLDER [...]

Measured over images of fresh training puzzles of the policy's task: the share of units that are never active (dead);
how much the others vary (mean standard deviation over images; 0 is a policy that ignores its observations); their
effective rank (participation ratio of the covariance's eigenvalues); and how much the value varies.
"""

import argparse
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from gym_open import artefacts
from gym_open.agents.encoder import Encoder
from gym_open.config import decode
from gym_open.formats.models import load_policy, policy_folder
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.policy import first_images

IMAGES = 300


@torch.no_grad()
def describe(folder: Path, images: torch.Tensor) -> list[str]:
    """Dead share, spread, effective rank, and standard deviation of the value, as a table row."""
    policy = load_policy(folder)
    if not isinstance(policy.encoder, Encoder):
        return ["–"] * 4
    prepared = policy.prepare(images)
    features, values = policy.encoder(prepared).float(), policy.get_value(prepared).float()
    dead = (features <= 0).all(dim=0).float().mean().item()
    energies = torch.linalg.svdvals(features - features.mean(dim=0)).square()
    rank = (energies.sum().square() / energies.square().sum()).item()
    return [f"{dead:.2f}", f"{features.std(dim=0).mean().item():.4f}", f"{rank:.1f}", f"{values.std().item():.4f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policies", type=Path, nargs="+")
    torch.set_num_threads(1)
    table = Table("policy", "steps", "dead", "spread", "effective rank", "value's deviation")
    images: dict[str, torch.Tensor] = {}
    for path in parser.parse_args().policies:
        config = decode(artefacts.config_of(path), PolicyTrainConfig, source=str(path))
        facts = artefacts.lineage(path).facts
        if config.task not in images:
            images[config.task] = first_images(PolicyTrainConfig(task=config.task, mean_images=IMAGES))
        steps = [one["step"] for one in facts["checkpoints"]]
        for step, folder in [*((one, policy_folder(path, one)) for one in steps), (facts["steps"], path)]:
            table.add_row(path.name, f"{step:,}", *describe(folder, images[config.task]))
    Console().print(table)


if __name__ == "__main__":
    main()
