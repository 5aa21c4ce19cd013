"""gym-open: OPEn, an open-ended physics environment for learning without a task, as data and offline learning."""

from pathlib import Path
from typing import TYPE_CHECKING

from gym_open import extras
from gym_open.envs.registration import ENV_IDS, PAPER_ENV_ID, register
from gym_open.version import __version__

if TYPE_CHECKING:
    from gym_open.agents.encoder import ImageEncoder

__all__ = ["ENV_IDS", "PAPER_ENV_ID", "__version__", "load_encoder"]

register()


def load_encoder(path: Path | str) -> "ImageEncoder":
    """Load the encoder in a folder: from `train encoder`, from a log, or fetched from the Hugging Face hub.

    `load_encoder(path).encode(images)` turns (B, 84, 84, 3) uint8 images into (B, features) float32.

    Raises:
        ArtefactError: if a file is missing or damaged, or a tensor does not fit the architecture.
        MissingExtraError: if torch is not installed.
    """
    extras.check("train")
    from gym_open.formats import models  # loads torch

    return models.load_encoder(Path(path))
