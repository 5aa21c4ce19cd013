"""Encoders and policies on disk: `model.safetensors` (tensors) and `model.json` (architecture)."""

from contextlib import suppress
from pathlib import Path
from typing import Literal, TypeVar

import msgspec
import torch
from torch import Tensor, nn

from gym_open.agents.architectures import make_encoder, make_image_encoder
from gym_open.agents.config import EncoderConfig, Width, check_symmetric
from gym_open.agents.encoder import ImageEncoder
from gym_open.agents.policy import ActorCritic
from gym_open.artefacts import canonical_json, lineage
from gym_open.errors import ArtefactError
from gym_open.files import write_atomically
from gym_open.formats.checkpoints import load_checkpoint, save_checkpoint

WEIGHTS, ARCHITECTURE = "model.safetensors", "model.json"


class EncoderArchitecture(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Contents of an encoder's model.json."""

    kind: Literal["encoder"] = "encoder"
    encoder: EncoderConfig

    def __post_init__(self) -> None:
        if self.encoder.architecture == "state":
            raise ValueError("`encoder.architecture` 'state' takes no images")


class PolicyArchitecture(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Contents of a policy's model.json."""

    kind: Literal["policy"] = "policy"
    encoder: EncoderConfig
    n_actions: Width
    trunk: tuple[Width, ...] = ()
    symmetric: bool = False

    def __post_init__(self) -> None:
        if self.symmetric:
            check_symmetric(self.encoder, self.trunk)


A = TypeVar("A", EncoderArchitecture, PolicyArchitecture)


def encoder_folder(artefact: Path) -> Path:
    """Folder of an artefact's encoder: `encoder/` in a log with its explorer's encoder, else the artefact itself."""
    own = artefact / "encoder"
    return own if (own / ARCHITECTURE).is_file() else artefact


def policy_folder(artefact: Path, step: int) -> Path:
    """Folder of the policy after `step` steps in a policy artefact."""
    return artefact / "checkpoints" / f"{step:09d}"


def save_encoder(folder: Path, encoder: ImageEncoder) -> None:
    """Write an encoder, including its mean image, into `folder`."""
    _save(folder, encoder, EncoderArchitecture(encoder=encoder.config))


def load_encoder(artefact: Path) -> ImageEncoder:
    """Read the encoder in the folder `artefact`; if that is a log, its explorer's encoder.

    Raises:
        ArtefactError: if a file is missing or damaged, or a tensor does not fit the architecture.
    """
    folder = encoder_folder(artefact)
    encoder = make_image_encoder(read_architecture(folder, EncoderArchitecture).encoder, torch.Generator())
    _load_weights(folder / WEIGHTS, encoder)
    return encoder


def save_policy(folder: Path, policy: ActorCritic) -> None:
    """Write a policy, including its encoder, into `folder`."""
    architecture = PolicyArchitecture(
        encoder=policy.encoder.config, n_actions=policy.n_actions, trunk=policy.widths, symmetric=policy.symmetric
    )
    _save(folder, policy, architecture)


def load_policy(artefact: Path) -> ActorCritic:
    """Read the policy in the folder `artefact`.

    Raises:
        ArtefactError: if a file is missing or damaged, or a tensor does not fit the architecture.
    """
    found = read_architecture(artefact, PolicyArchitecture)
    nothing = torch.Generator()
    policy = ActorCritic(
        make_encoder(found.encoder, nothing), found.n_actions, nothing, trunk=found.trunk, symmetric=found.symmetric
    )
    _load_weights(artefact / WEIGHTS, policy)
    return policy


def read_architecture(artefact: Path, kind: type[A]) -> A:
    """Read the architecture of the model in the folder `artefact`.

    Raises:
        ArtefactError: if the file is missing, damaged, or of another kind of model.
    """
    path = artefact / ARCHITECTURE
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise ArtefactError(_no_model(artefact)) from None
    try:
        return msgspec.json.decode(data, type=kind)
    except (UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not JSON: {str(error)[:100]}; get the model again") from None
    except msgspec.DecodeError as error:
        names = {"encoder": "an encoder", "policy": "a policy"}
        wanted = names.pop("encoder" if kind is EncoderArchitecture else "policy")
        with suppress(msgspec.DecodeError, RecursionError):
            if given := names.get(msgspec.json.decode(data, type=_ModelKind).kind):
                raise ArtefactError(f"{artefact}: {given}, not {wanted}; give the folder of {wanted}") from None
        raise ArtefactError(f"{path}: not {wanted} as gym-open writes it: {error}") from None


class _ModelKind(msgspec.Struct, frozen=True):
    """The kind of model in a model.json; all other fields are ignored."""

    kind: str


def _no_model(folder: Path) -> str:
    if not folder.is_dir():
        return f"{folder}: no such folder; train a model or give another folder"
    with suppress(ArtefactError):
        if lineage(folder).kind == "log":
            return (
                f"{folder}: a log without an encoder, since its explorer learned none (a random explorer learns "
                "nothing); give an encoder, or a log of another explorer"
            )
    return f"{folder / ARCHITECTURE}: missing, so there is no model here; train one or give its folder"


def _save(folder: Path, model: nn.Module, architecture: EncoderArchitecture | PolicyArchitecture) -> None:
    save_checkpoint(folder / WEIGHTS, model.state_dict(), {})
    write_atomically(folder / ARCHITECTURE, canonical_json(architecture))


def _load_weights(path: Path, model: nn.Module) -> None:
    found, _ = load_checkpoint(path)
    expected: dict[str, Tensor] = model.state_dict()
    for name in sorted(expected.keys() | found.keys()):
        if name not in found:
            raise ArtefactError(f"{path}: tensor {name!r} is missing; {ARCHITECTURE} does not belong to this file")
        if name not in expected:
            raise ArtefactError(f"{path}: tensor {name!r} is unknown; {ARCHITECTURE} does not belong to this file")
        if found[name].shape != expected[name].shape:
            raise ArtefactError(
                f"{path}: tensor {name!r} should have shape {tuple(expected[name].shape)}, "
                f"got {tuple(found[name].shape)}; {ARCHITECTURE} does not belong to this file"
            )
        if found[name].dtype != expected[name].dtype:
            raise ArtefactError(
                f"{path}: tensor {name!r} should be {expected[name].dtype}, got {found[name].dtype}; get it again"
            )
        if not torch.isfinite(found[name]).all():
            raise ArtefactError(f"{path}: tensor {name!r} holds numbers that are not finite; get the model again")
    model.load_state_dict(found)
