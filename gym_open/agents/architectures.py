"""Every encoder by the name of its architecture."""

import torch

from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder, ImageEncoder, StateEncoder
from gym_open.agents.objects.encoders import KeypointEncoder, SlotEncoder


def make_encoder(config: EncoderConfig, generator: torch.Generator) -> ImageEncoder | StateEncoder:
    """The untrained encoder that the configuration names, with weights from `generator`."""
    return StateEncoder(config) if config.architecture == "state" else make_image_encoder(config, generator)


def make_image_encoder(config: EncoderConfig, generator: torch.Generator) -> ImageEncoder:
    """The same for an encoder of images.

    Raises:
        ValueError: if the architecture takes the simulator state.
    """
    match config.architecture:
        case "slots":
            return SlotEncoder(config, generator)
        case "keypoints":
            return KeypointEncoder(config, generator)
        case "state":
            raise ValueError("the architecture 'state' takes no images; give cnn, impala, slots or keypoints")
        case _:
            return Encoder(config, generator)
