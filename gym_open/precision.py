"""The number format in which networks compute: bf16 if the processor multiplies it natively, else fp32.

A processor without bf16 instructions emulates them, which is about ten times slower than fp32. The default setting,
`auto`, therefore asks the processor. Weights, losses and sums of gradients are fp32 in both precisions.
"""

import functools
import platform
from pathlib import Path
from typing import Literal

from gym_open.errors import ArtefactError
from gym_open.files import write_atomically
from gym_open.progress import console

Precision = Literal["fp32", "bf16"]
"""Number format in which a network computes."""
PrecisionSetting = Literal["auto", "fp32", "bf16"]
"""Setting in a configuration."""
FILE = "precision"
"""File with the checkpoints of an unfinished run: the precision in which the run began."""


@functools.cache
def native_precision(device: str = "cpu") -> Precision:
    """`bf16` if `device` ("cpu" or "cuda") multiplies it natively, else `fp32`.

    On a CPU, environment variables such as ONEDNN_MAX_CPU_ISA count too: they limit the instructions that run.
    """
    import torch

    if device == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported(including_emulation=False) else "fp32"
    # oneDNN computes the layers. It claims bf16 for every AVX-512 processor, although it emulates bf16 on those without
    # the instructions. On Arm it asks the processor.
    usable = torch.backends.mkldnn.is_available() and torch.ops.mkldnn._is_mkldnn_bf16_supported()  # noqa: SLF001
    return "bf16" if usable and (_is_arm() or _has_bf16_instructions()) else "fp32"


def _is_arm() -> bool:
    return platform.machine().lower() in {"aarch64", "arm64"}


def _has_bf16_instructions() -> bool:
    """Whether an x86-64 processor has AVX-512-BF16 or AMX, by the instruction `cpuid`."""
    import torch

    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()  # noqa: SLF001


def resolve(setting: PrecisionSetting, device: str = "cpu") -> Precision:
    """The precision that `setting` means on `device`."""
    return native_precision(device) if setting == "auto" else setting


def settle(setting: PrecisionSetting, device: str, scratch: Path) -> Precision:
    """Decide the precision of a run. It stays the same until the run ends, also if the run is killed and resumed.

    Args:
        setting: the precision in the configuration.
        device: "cpu" or "cuda", where the network computes.
        scratch: folder of the files for a resume. A new run writes its precision there, and a resumed run reads it.

    Raises:
        ArtefactError: if the record in `scratch` is damaged.
    """
    mark, native = scratch / FILE, native_precision(device)
    if mark.is_file():
        began = mark.read_bytes()
        if began not in {b"fp32", b"bf16"}:
            raise ArtefactError(
                f"{mark}: expected fp32 or bf16, got {began[:16]!r}; restore the file, or remove the unfinished folder "
                "to start over"
            )
        chosen: Precision = "fp32" if began == b"fp32" else "bf16"
        how = "this run began in"
    else:
        chosen = native if setting == "auto" else setting
        how = "the configuration asks for" if chosen == "bf16" else ""  # small networks gain nothing from bf16
        scratch.mkdir(parents=True, exist_ok=True)
        write_atomically(mark, chosen.encode())
    if how and chosen != native:
        _warn(chosen, how)
    return chosen


def _warn(chosen: Precision, how: str) -> None:
    cost = "bf16 is emulated here, about ten times slower than fp32" if chosen == "bf16" else "bf16 is faster here"
    console.print(f"precision: {how} {chosen}; {cost}", style="yellow", highlight=False, soft_wrap=True)
