"""Machine code on disk is compiled again when any compiled source changes."""

import sys
from pathlib import Path

from gym_open.envs import jit
from tests import children

CALLED = "from gym_open.envs.jit import compiled\n\n\n@compiled\ndef called():\n    return {}\n"
CALLER = """\
import sys, pathlib
from gym_open.envs import jit
jit.__file__ = __file__  # these files take the place of the package's
from gym_open.envs.jit import compiled
from called import called

@compiled
def caller():
    return called()

print(caller())
"""


def run(folder: Path) -> str:
    done = children.run([sys.executable, "caller.py"], cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_change_of_a_called_function_in_another_file_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "called.py").write_text(CALLED.format(1))
    assert [run(tmp_path), run(tmp_path)] == ["1\n", "1\n"]
    assert list((tmp_path / "__pycache__").glob("caller.caller-*.nbc"))
    (tmp_path / "called.py").write_text(CALLED.format(2))
    assert run(tmp_path) == "2\n"


def test_a_moved_type_is_compiled_again(tmp_path: Path) -> None:
    """Numba's cache names the modules of its types, and numba cannot read the cache if such a module is missing."""
    caller = CALLER.replace("import called", "import called, Pair").replace("caller()", "caller(Pair(1))")
    caller = caller.replace("def caller(Pair(1))", "def caller(pair)").replace(
        "return called()", "return called() + pair.one"
    )
    typed = "from typing import NamedTuple\n\n\nclass Pair(NamedTuple):\n    one: int\n\n\n" + CALLED.format(1)
    (tmp_path / "caller.py").write_text(caller)
    (tmp_path / "called.py").write_text(typed)
    assert [run(tmp_path), run(tmp_path)] == ["2\n", "2\n"]
    (tmp_path / "called.py").rename(tmp_path / "moved.py")
    (tmp_path / "kept.py").write_text(caller.replace("from called", "from moved"))
    (tmp_path / "kept.py").replace(tmp_path / "caller.py")
    assert run(tmp_path) == "2\n"


def test_only_compiled_sources_count(tmp_path: Path) -> None:
    digests = []
    for name, text in (("a.py", "@compiled"), ("b.py", "plain"), ("b.py", "other"), ("a.py", "@compiled\n")):
        (tmp_path / name).write_text(text)
        jit.source_digest.cache_clear()
        digests.append(jit.source_digest(tmp_path))
    assert digests[0] == digests[1] == digests[2] != digests[3]
