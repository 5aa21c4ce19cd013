"""Every world model by its name; exploration and off-line training make theirs here."""

from collections.abc import Callable
from typing import Protocol

import torch

from gym_open.agents.config import CurlConfig, IcmConfig, RndConfig, WorldModelName
from gym_open.agents.curl import Curl
from gym_open.agents.encoder import Encoder
from gym_open.agents.icm import Icm
from gym_open.agents.rnd import Rnd
from gym_open.agents.world_model import WorldModel


class WorldModelConfigs(Protocol):
    """A configuration with a part for each world model."""

    @property
    def icm(self) -> IcmConfig:
        """Looked at by `icm` alone."""
        ...

    @property
    def rnd(self) -> RndConfig:
        """Looked at by `rnd` alone."""
        ...

    @property
    def curl(self) -> CurlConfig:
        """Looked at by `curl` alone."""
        ...


WORLD_MODELS: dict[WorldModelName, Callable[[WorldModelConfigs, Encoder, int, torch.Generator], WorldModel]] = {
    "icm": lambda config, encoder, n_actions, init: Icm(encoder, config.icm, n_actions, init),
    "rnd": lambda config, encoder, _, init: Rnd(encoder, config.rnd, init),
    "curl": lambda config, encoder, _, init: Curl(encoder, config.curl, init),
}
"""Made of a configuration, on an encoder, for a number of actions, with weights from a generator."""
