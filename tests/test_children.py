"""No process outlives the test that started it: neither when the test gives up, nor when its own process is killed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.children import is_alive, killed_at, run, started, until

FAMILY = """
import os, pathlib, signal, subprocess, sys
signal.signal(signal.SIGTERM, signal.SIG_IGN)  # only a kill ends it
if sys.argv[2] == "0":
    pathlib.Path(sys.argv[1], "ready").touch()
else:
    words = [sys.executable, "-c", sys.argv[3], sys.argv[1], str(int(sys.argv[2]) - 1), sys.argv[3]]
    subprocess.Popen(words)
pathlib.Path(sys.argv[1], f"{os.getpid()}.pid").touch()
signal.pause()
"""
"""A child with a child with a child, none of which ends by itself."""
TESTS = """
import importlib.util, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("children", sys.argv[1])
children = importlib.util.module_from_spec(spec)
spec.loader.exec_module(children)
with children.started(sys.argv[2:]):
    print("started", flush=True)
    sys.stdin.read()
"""
"""Stands for the process that runs the tests."""


def family(folder: Path) -> list[str]:
    return [sys.executable, "-c", FAMILY, str(folder), "2", FAMILY]


def born(folder: Path) -> list[int]:
    """Process numbers of the three, once they are there."""
    until(lambda: len(list(folder.glob("*.pid"))) == 3 and (folder / "ready").exists())
    return [int(path.stem) for path in folder.glob("*.pid")]


@pytest.mark.parametrize("error", [AssertionError, KeyboardInterrupt, pytest.fail.Exception])
def test_a_test_that_gives_up_ends_its_children_and_theirs(tmp_path: Path, error: type[BaseException]) -> None:
    """`pytest.fail` is what pytest's time limit calls."""
    alive = []

    def give_up() -> None:
        with started(family(tmp_path)):
            alive.extend(born(tmp_path))
            assert all(map(is_alive, alive))
            raise error

    with pytest.raises(error):
        give_up()
    for pid in alive:
        until(lambda pid=pid: not is_alive(pid))
    assert len(alive) == 3


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM])
def test_when_the_tests_own_process_is_killed_nobody_is_left(tmp_path: Path, sign: signal.Signals) -> None:
    words = [sys.executable, "-c", TESTS, str(Path(__file__).with_name("children.py")), *family(tmp_path)]
    with started(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as tests:
        alive = born(tmp_path)
        os.kill(tests.pid, sign)
        assert tests.wait() == -sign
        for pid in alive:
            until(lambda pid=pid: not is_alive(pid))


def test_what_a_process_said_and_how_it_ended_is_told() -> None:
    done = run([sys.executable, "-c", "import sys; print('out'); sys.exit('error')"])
    assert (done.returncode, done.stdout, done.stderr) == (1, "out\n", "error\n")


def test_a_process_is_killed_where_it_was_to_be(tmp_path: Path) -> None:
    code = "\n".join(f"open(sys.argv[1] + '/{i}.txt', 'w').close()" for i in range(4))
    killed_at(tmp_path, "2.*", code, tmp_path)
    assert not (tmp_path / "3.txt").exists()
    assert (tmp_path / "2.txt").exists()
    with pytest.raises(AssertionError, match="ended before it could be killed"):
        killed_at(tmp_path, "4.*", code, tmp_path)
