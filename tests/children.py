"""Processes that tests start, and events that they wait for. No test counts seconds.

A machine may be slow or busy, so nothing here has a limit of its own. What hangs is ended by pytest's limit for a test
(`timeout` in pyproject.toml), which is for hangs alone.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

HANG_S = 1800.0
"""Seconds for what must be given a limit: pytest's own, in pyproject.toml."""

T = TypeVar("T")
Words = Sequence[str | Path]

_DIES = """
import fnmatch, os, signal, sys
folder, pattern = sys.argv[1:3]
del sys.argv[1:3]
def look(event, _):
    if event in ("open", "os.rename") and os.path.isdir(folder) and fnmatch.filter(os.listdir(folder), pattern):
        os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(look)
"""


@contextmanager
def started(words: Words, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """A process, which is killed when this is left, and when the process that runs the tests dies, however it dies.

    So is all that it has started, unless that made a process group of its own. `options` are those of `Popen`.
    """
    with _group() as group, subprocess.Popen(words, process_group=group, **options) as process:
        try:
            yield process
        finally:
            os.killpg(group, signal.SIGKILL)


@contextmanager
def _group() -> Iterator[int]:
    """A process group and its first process, which kills the group when it can read from us no more."""
    silent: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    words = ["sh", "-c", "read -r _; kill -KILL 0"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, process_group=0, **silent) as first:
        try:
            yield first.pid
        finally:
            first.kill()


def run(words: Words, **options: Any) -> subprocess.CompletedProcess[str]:
    """Start a process, wait until it ends, and give what it said. `options` are those of `Popen`."""
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **options}
    with started(words, **given) as process:
        said, error = process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, said, error)


def python(code: str, *words: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """`run` for Python code and its arguments."""
    return run([sys.executable, "-c", code, *words], **options)


def killed_at(folder: Path, pattern: str, code: str, *words: str | Path, **options: Any) -> None:
    """Run Python code in a process that is ended by SIGKILL as soon as a file in `folder` matches `pattern`.

    The process looks for itself at each file that it opens or renames, so that it cannot be over before anybody looks.
    """
    done = python(_DIES + code, folder, pattern, *words, **options)
    assert done.returncode == -signal.SIGKILL, f"ended before it could be killed: {done.stdout}{done.stderr}"


def until(event: Callable[[], T], process: subprocess.Popen[Any] | None = None) -> T:
    """Wait until `event()` is true, and give what it gave; an error if `process` ends before that."""
    while not (found := event()):
        assert process is None or process.poll() is None, f"{process.args}: ended by {process.returncode}"
        time.sleep(0.005)
    return found


def is_alive(pid: int) -> bool:
    """Whether a process runs, and does not only wait for its parent to hear that it ended."""
    try:
        os.kill(pid, 0)
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except (ProcessLookupError, FileNotFoundError):
        return False
