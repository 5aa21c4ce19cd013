"""Signals that end a process, and children that end with their parent, however it ends."""

import ctypes
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does; only in the main thread.

    Yields a function that tells whether one of the three came. Code that waits without an end asks it: a library may
    have swallowed the exception, as happened once while Rerun 0.41 took data.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # only that one may say what a signal does
        yield lambda: False
        return

    def interrupt(sign: int, _: FrameType | None) -> None:
        came.append(sign)
        raise KeyboardInterrupt

    signs = [signal.SIGTERM, signal.SIGHUP]
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signs.append(signal.SIGINT)
    before = {sign: signal.signal(sign, interrupt) for sign in signs}
    try:
        yield lambda: bool(came)
    finally:
        for sign, handler in before.items():
            signal.signal(sign, handler)


def end_with_parent() -> None:
    """In a child: be ended when the parent dies, even if that is killed outright. Only Linux has such a thing."""
    if sys.platform == "linux":
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
