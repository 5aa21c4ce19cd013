"""What a result was computed on, for records that people compare."""

import os
import platform
from pathlib import Path


def hardware(threads: int, device: str = "cpu") -> dict[str, str | int]:
    """Processor, cores of this machine, threads that were used, and the device: "cpu", or the name of the GPU."""
    name = device
    if device == "cuda":
        import torch

        name = torch.cuda.get_device_name()
    return {"processor": _processor(), "cores": os.cpu_count() or 1, "threads": threads, "device": name}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # no Linux
        return platform.processor() or platform.machine()
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
