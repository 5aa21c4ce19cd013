"""The hardware that computed a result, and the cores that this process may use."""

import os
import platform
from contextlib import suppress
from pathlib import Path

from gym_open.errors import ConfigError


def hardware(threads: int, device: str = "cpu") -> dict[str, str | int]:
    """The processor, the cores of this machine, the threads used, and the device: "cpu", or the name of the GPU."""
    name = device
    if device == "cuda":
        import torch

        name = torch.cuda.get_device_name()
    return {"processor": _processor(), "cores": os.cpu_count() or 1, "threads": threads, "device": name}


def check_device(device: str) -> None:
    """Raise ConfigError if the configuration asks for a GPU and PyTorch finds none."""
    if device == "cuda":
        import torch

        if not torch.cuda.is_available():
            raise ConfigError(f"key `device`: {device!r} asks for a GPU, but PyTorch finds none; use 'cpu'")


def usable_cores(groups: Path = Path("/sys/fs/cgroup")) -> int:
    """Number of cores that this process may use: its processor affinity, or fewer if its control group allows fewer.

    Args:
        groups: folder where Linux shows control groups, of version 1 or 2.
    """
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for folder in (groups, groups / "cpu"):
        with suppress(OSError, ValueError, ZeroDivisionError):
            quota, period = (folder / "cpu.max").read_text().split()
            found = min(found, int(quota) // int(period))
        with suppress(OSError, ValueError, ZeroDivisionError):
            quota, period = ((folder / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period"))
            found = min(found, int(quota) // int(period)) if int(quota) > 0 else found
    return max(found, 1)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # no Linux
        return platform.processor() or platform.machine()
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
