"""Children that end when their parent ends, however it ends."""

import ctypes
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


@contextmanager
def interruptible() -> Iterator[None]:
    """Being told to end, or losing the terminal, is taken as Ctrl-C is; only in the main thread."""
    if threading.current_thread() is not threading.main_thread():  # only that one may say what a signal does
        yield
        return
    signs = (signal.SIGTERM, signal.SIGHUP)
    before = {sign: signal.signal(sign, signal.default_int_handler) for sign in signs}
    try:
        yield
    finally:
        for sign, handler in before.items():
            signal.signal(sign, handler)


def end_with_parent() -> None:
    """In a child: be ended when the parent dies, even if that is killed outright. Only Linux has such a thing."""
    if sys.platform == "linux":
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
