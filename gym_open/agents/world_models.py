"""Every world model by its name. Exploration and off-line training create theirs here."""

from importlib import import_module

import torch

from gym_open.agents.config import OfflineModelName, WorldModelName, WorldModelSections
from gym_open.agents.encoder import ImageEncoder
from gym_open.agents.world_model import WorldModel

WORLD_MODELS: tuple[WorldModelName, ...] = WorldModelSections.__struct_fields__


def make_world_model(
    name: OfflineModelName,
    config: WorldModelSections,
    encoder: ImageEncoder,
    n_actions: int,
    generator: torch.Generator,
) -> WorldModel:
    """Create an untrained world model: for the name `ae`, the class `Ae` in `gym_open/agents/ae.py`.

    Args:
        name: one of `WORLD_MODELS`, or `objects`, which only off-line training has.
        config: holds the section of that name.
        encoder: from images to features; the world model trains it.
        n_actions: number of actions.
        generator: source of the weights.
    """
    kind = getattr(import_module(f"gym_open.agents.{name}"), name.capitalize())
    return kind(encoder, config.section(name), n_actions, generator)
