"""The ceiling baseline's encoder: from the simulator's state to features, without seeing anything."""

import torch
from torch import Tensor, nn

from gym_open.agents.config import EncoderConfig
from gym_open.agents.layers import init_layer
from gym_open.envs.state import STATE_SIZE


class StateEncoder(nn.Module):
    """State to features: two hidden layers, tanh, as PPO's policies on state are in CleanRL's `ppo.py`."""

    shape = (STATE_SIZE,)
    """Of what it is told."""
    dtype = torch.float32
    """Of what it is told."""

    def __init__(self, config: EncoderConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.config = config
        first, second = nn.Linear(STATE_SIZE, config.features), nn.Linear(config.features, config.features)
        for layer in (first, second):
            init_layer(layer, generator)
        self.layers = nn.Sequential(first, nn.Tanh(), second, nn.Tanh())

    def prepare(self, states: Tensor) -> Tensor:
        """The states themselves, (B, `STATE_SIZE`) float32."""
        return states

    def prepare_shifted(self, states: Tensor, shifts: Tensor) -> Tensor:  # noqa: ARG002  (there is no picture)
        """The states themselves: there is no picture to shift."""
        return states

    def forward(self, prepared: Tensor) -> Tensor:
        """Features (B, features) of states."""
        return self.layers(prepared)
