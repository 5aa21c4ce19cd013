"""Checkpoints: one safetensors file with named tensors and everything else as JSON in its header. No pickle."""

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from gym_open.errors import ArtefactError
from gym_open.files import write_atomically
from gym_open.progress import console

_META = "gym_open"
"""The only key of the header's metadata; safetensors does not write several keys in a fixed order."""


def save_checkpoint(path: Path, tensors: dict[str, Tensor], meta: dict[str, Any]) -> None:
    """Write `tensors` and JSON-ready `meta` to `path`; readers see either the old or the new checkpoint.

    Equal contents give equal bytes. Integers in `meta` may have any size; NumPy's generators have 128 bits.
    """
    # safetensors refuses tensors that share memory (one encoder with two owners), so each gets its own copy.
    own = {name: tensor.detach().clone(memory_format=torch.contiguous_format) for name, tensor in tensors.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, save(own, metadata={_META: json.dumps(meta, sort_keys=True)}))


def load_checkpoint(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `save_checkpoint` wrote.

    Raises:
        ArtefactError: if the file is missing, cut, not safetensors, or was not written by gym-open.
    """
    try:
        with safe_open(path, framework="pt") as file:
            meta = (file.metadata() or {}).get(_META)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a mapping)
    except FileNotFoundError:
        raise ArtefactError(f"{path}: no such file") from None
    except (SafetensorError, OSError) as error:
        raise ArtefactError(f"{path}: not a whole safetensors file ({error}); remove it and run again") from None
    if meta is None:
        raise ArtefactError(f"{path}: header lacks the key {_META!r}, so gym-open did not write it; give another file")
    try:
        return tensors, json.loads(meta)
    except (ValueError, RecursionError) as error:
        raise ArtefactError(f"{path}: its metadata is not JSON ({str(error)[:100]}); get the file again") from None


def save_resumable(path: Path, tensors: dict[str, Tensor], meta: dict[str, Any]) -> None:
    """Write a checkpoint from which a killed run continues, with a digest of its contents.

    The checkpoint before it is kept beside it, as `before-NAME`.
    """
    if path.exists():
        path.replace(_before(path))
    save_checkpoint(path, tensors, {"meta": meta, "sha256": _digest(tensors, meta)})


def load_resumable(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """Read the newest whole checkpoint at `path`, or the one before it. None if there is none: start afresh.

    A damaged checkpoint is never used; what happens instead is printed.
    """
    damaged = False
    for place in (path, _before(path)):
        if not place.exists():
            continue
        found = _whole(place)
        if found is not None:
            if damaged:
                console.print(f"{path}: damaged; the run continues from the checkpoint before it", highlight=False)
            return found
        damaged = True
    if damaged:
        console.print(f"{path}: damaged, and there is no whole one before it; the run starts again", highlight=False)
    return None


def _before(path: Path) -> Path:
    return path.with_name(f"before-{path.name}")


def _whole(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """The contents of a checkpoint; None if they do not have the digest that it names."""
    try:
        tensors, said = load_checkpoint(path)
        meta = said["meta"]
        return (tensors, meta) if said["sha256"] == _digest(tensors, meta) else None
    except (ArtefactError, KeyError, TypeError, ValueError, RecursionError):
        return None


def _digest(tensors: dict[str, Tensor], meta: dict[str, Any]) -> str:
    """SHA-256 of names, types, shapes and bytes of all tensors, and of `meta`."""
    total = hashlib.sha256(json.dumps(meta, sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        total.update(json.dumps([name, str(tensor.dtype), list(tensor.shape)]).encode())
        flat = tensor.detach().cpu().contiguous().reshape(-1)
        total.update(flat.view(torch.uint8).numpy().data)
    return total.hexdigest()


def optimizer_tensors(optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Adam's state as `<index of the parameter>.<name>`, for example `3.exp_avg`."""
    state = optimizer.state_dict()["state"]
    return {f"{index}.{name}": value for index, values in state.items() for name, value in values.items()}


def load_optimizer(optimizer: torch.optim.Optimizer, tensors: dict[str, Tensor]) -> None:
    """Restore Adam's state from the result of `optimizer_tensors`; learning rates stay unchanged."""
    weights = [weight for group in optimizer.param_groups for weight in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        index, field = name.split(".", 1)
        weight = weights[int(index)]
        # A fused step needs weight and moments in the same memory layout; files store them row by row.
        own = torch.empty_like(weight, requires_grad=False).copy_(value) if value.shape == weight.shape else value
        state.setdefault(int(index), {})[field] = own
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def prefixed(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same tensors, with `prefix/` before each name."""
    return {f"{prefix}/{name}": tensor for name, tensor in tensors.items()}


def without_prefix(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The tensors whose name begins with `prefix/`, under the name without it."""
    return {
        name.removeprefix(f"{prefix}/"): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}/")
    }
