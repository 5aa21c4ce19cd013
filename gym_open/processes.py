"""Signals that end a process, and child processes that end with their parent, however it ends."""

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
    """Context manager: SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does. It works only in the main thread.

    It yields a function that returns whether one of the three signals arrived. An endless loop must call that function:
    a library may have swallowed the exception, as Rerun 0.41 once did while it received data.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set signal handlers
        yield lambda: False
        return

    def interrupt(sign: int, _: FrameType | None) -> None:
        received.append(sign)
        raise KeyboardInterrupt

    signs = [signal.SIGTERM, signal.SIGHUP]
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signs.append(signal.SIGINT)
    before = {sign: signal.signal(sign, interrupt) for sign in signs}
    try:
        yield lambda: bool(received)
    finally:
        for sign, handler in before.items():
            signal.signal(sign, handler)


def end_with_parent() -> None:
    """In a child process: make the system end it when its parent dies, even by SIGKILL. Only Linux can do this."""
    if sys.platform == "linux":
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
