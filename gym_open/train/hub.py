"""Send encoders to a Hugging Face hub and load them from one, through the mixin of `huggingface_hub`."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import msgspec
import numpy as np
import torch
from huggingface_hub import ModelCard, PyTorchModelHubMixin, snapshot_download
from huggingface_hub.errors import HFValidationError, LocalEntryNotFoundError
from huggingface_hub.utils import validate_repo_id  # pyright: ignore[reportPrivateImportUsage]
from torch import Tensor, nn

from gym_open import artefacts
from gym_open.agents.architectures import make_image_encoder
from gym_open.agents.config import EncoderConfig
from gym_open.artefacts import MANIFEST, Lineage
from gym_open.config import to_dict
from gym_open.errors import GymOpenError, UsageError
from gym_open.formats.models import ARCHITECTURE, WEIGHTS, load_encoder, save_encoder
from gym_open.terminal import printable

CARD = "README.md"


class HubEncoder(
    nn.Module,
    PyTorchModelHubMixin,
    library_name="gym-open",
    license="mit",
    tags=["feature-extraction", "reinforcement-learning"],
    coders={EncoderConfig: (to_dict, lambda data: msgspec.convert(data, EncoderConfig))},
):
    """An encoder with `save_pretrained`, `from_pretrained` and `push_to_hub`.

    An encoder made from an artefact carries the whole artefact, so that a fetched copy can still prove its origin.

    Args:
        encoder: configuration of the network; the mixin keeps it in `config.json`.

    Attributes:
        network: the encoder itself.
    """

    artefact: Path | None = None

    def __init__(self, encoder: EncoderConfig) -> None:
        super().__init__()
        self.config = encoder
        self.network = make_image_encoder(encoder, torch.Generator())

    def encode(self, images: Tensor | np.ndarray) -> Tensor:
        """Features (B, width), fp32 and without gradient, of images (B, 84, 84, 3) uint8."""
        return self.network.encode(images)

    def forward(self, images: Tensor) -> Tensor:
        """The same with gradients, if the network has them."""
        return self.network(self.network.prepare(images))

    @classmethod
    def of(cls, artefact: Path) -> Self:
        """Load the encoder from the folder `artefact`.

        Raises:
            ArtefactError: if a file is missing or damaged.
        """
        source = load_encoder(artefact)
        made = cls(encoder=source.config)
        made.network = source
        return made

    def _save_pretrained(self, save_directory: Path) -> None:
        if self.artefact is None:
            save_encoder(save_directory, self.network)
            return
        for name in _files(self.artefact):
            (save_directory / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.artefact / name, save_directory / name)

    @classmethod
    def _from_pretrained(  # pyright: ignore[reportIncompatibleMethodOverride]  (the arguments that are left out have no effect)
        cls,
        *,
        model_id: str,
        revision: str | None = None,
        cache_dir: str | Path | None = None,
        force_download: bool = False,
        local_files_only: bool = False,
        token: str | bool | None = None,
        **_: object,
    ) -> Self:
        """Load as `load_encoder` does: check every tensor, and never read a pickle, to which the mixin falls back."""
        folder = Path(model_id)
        if not folder.is_dir():
            fetched = snapshot_download(
                model_id, allow_patterns=[ARCHITECTURE, WEIGHTS], revision=revision, cache_dir=cache_dir,
                force_download=force_download, local_files_only=local_files_only, token=token,
            )  # fmt: skip
            folder = Path(fetched)
        return cls.of(folder)

    def generate_model_card(self, *_: object, repository: str = "OWNER/NAME", **__: object) -> ModelCard:
        """Make a card: the network, how to use it, and the data that it was learned from."""
        lines = ["---", self._hub_mixin_info.model_card_data.to_yaml(), "---", "", *self._described(repository)]
        if self.artefact is not None:
            lines += ["", *_origin(artefacts.digest(self.artefact), artefacts.lineage(self.artefact))]
        return ModelCard("\n".join(lines) + "\n")

    def _described(self, repository: str) -> list[str]:
        config = self.config
        return [
            "# An image encoder of gym-open", "",
            f"Network `{config.architecture}`: 84×84 RGB images of OPEn's table to {config.width:,} features.", "",
            "```python", "from gym_open.train.hub import HubEncoder", "",
            f'encoder = HubEncoder.from_pretrained("{repository}")',
            f"features = encoder.encode(images)  # (B, 84, 84, 3) uint8 to (B, {config.width}) float32", "```",
        ]  # fmt: skip


def push_encoder(encoder: Path, repository: str, *, online: bool) -> list[str]:
    """Send the whole encoder artefact `encoder`, with a card, to a model repository of a hub.

    It replaces the files in the repository; the repository's history keeps them. The hub is the one that HF_ENDPOINT
    names, or huggingface.co. The token is the one that `hf auth login` stored, or HF_TOKEN.

    Args:
        encoder: an encoder artefact. Every byte of it is checked first.
        repository: OWNER/NAME; it is created if it is missing.
        online: use the network. Without it nothing is sent.

    Returns:
        The files that were sent, or would be sent, one per line.

    Raises:
        ArtefactError: if the encoder is damaged.
        UsageError: if the repository is not called OWNER/NAME.
        GymOpenError: if the hub cannot be reached, or refuses.
    """
    digest = artefacts.verify(encoder, "encoder")
    check_repository(repository)
    model = HubEncoder.of(encoder)
    model.artefact = encoder
    plan = [f"{(encoder / name).stat().st_size:>13,}  {name}" for name in sorted(_files(encoder))]
    plan.append(f"{len(str(model.generate_model_card(repository=repository)).encode()):>13,}  {CARD}")
    if online:
        try:
            address = model.push_to_hub(
                repository, commit_message=f"Encoder {digest[:16]}", model_card_kwargs={"repository": repository},
                delete_patterns="*",
            )  # fmt: skip
        except (
            OSError,
            RuntimeError,
            ValueError,
            LocalEntryNotFoundError,
        ) as error:  # the errors that the client raises
            raise GymOpenError(
                f"{repository}: nothing was pushed ({type(error).__name__}: {str(error)[:300]}); check the name and "
                "the network, log in with `hf auth login`, and run the same command again"
            ) from error
        plan.append(f"sent to {address}")
    else:
        plan.append(f"encoder {digest[:16]} to {repository}")
    return plan


def check_repository(repository: str) -> None:
    """Raise UsageError unless `repository` is OWNER/NAME as hubs have it."""
    try:
        validate_repo_id(repository)
    except HFValidationError:
        valid = False
    else:
        valid = repository.count("/") == 1
    if not valid:
        raise UsageError(f"a repository must be OWNER/NAME, got {repository!r}")


def _files(artefact: Path) -> list[str]:
    return [*artefacts.manifest(artefact), MANIFEST]


def _origin(digest: str, lineage: Lineage) -> Iterator[str]:
    yield "## Where it comes from"
    yield ""
    model, updates, frames = (printable(str(lineage.facts.get(name))) for name in ("world_model", "updates", "frames"))
    yield f"Learned off-line by `{model}`: {updates} updates on {frames} frames."
    yield ""
    yield f"- encoder `{digest}`, code `{printable(lineage.code)}`"
    yield from _chain(lineage, 1)
    yield ""
    yield "All files except this one and the hub's own form an artefact, from which gym-open trains policies."
    yield "Its `lineage.json` names every puzzle that was explored for it."


def _chain(lineage: Lineage, depth: int) -> Iterator[str]:
    for parent in lineage.parents:
        yield f"{'  ' * depth}- {parent.lineage.kind} `{parent.digest}`"
        yield from _chain(parent.lineage, depth + 1)
