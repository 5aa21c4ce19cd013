"""Compiling with numba, cached on disk wherever this process may write."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numba.core.config


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on first call, without the interpreter lock, and keep the machine code for later processes.

    Where neither the package's folder nor the user's cache folder can be written, a temporary one is used.
    """
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # no folder to cache in
        numba.core.config.CACHE_DIR = str(Path(tempfile.gettempdir()) / "gym-open-numba")  # pyright: ignore[reportAttributeAccessIssue]
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
