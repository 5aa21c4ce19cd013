"""A folder that lacks a stream, or has two of them swapped, is no log, although each file of it is whole."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from gym_open import artefacts
from gym_open.cli import main
from gym_open.errors import ArtefactError
from gym_open.formats.logs import open_logs
from gym_open.formats.logs.info import info_tables
from tests.datasets.compact.conftest import random_log  # noqa: F401  # a fixture


@pytest.fixture
def log(random_log: Path, tmp_path: Path) -> Path:  # noqa: F811
    return Path(shutil.copytree(random_log, tmp_path / "log"))


def _swap(folder: Path) -> None:
    one, other = folder / "stream-000-000.mcap", folder / "stream-001-000.mcap"
    one.rename(folder / "aside")
    other.rename(one)
    (folder / "aside").rename(other)


def _lose(folder: Path) -> None:
    (folder / "stream-001-000.mcap").unlink()


def _change(folder: Path) -> None:
    (folder / "summary.json").write_text("{}")


@pytest.mark.parametrize("change", [_swap, _lose, _change])
def test_the_manifest_counts(log: Path, change: Callable[[Path], None]) -> None:
    assert info_tables(log)[1] == []
    change(log)
    assert info_tables(log)[1]
    with pytest.raises(ArtefactError):
        open_logs(log)
    assert main(["log", "info", str(log)]) == 1
    assert main(["log", "replay", str(log)]) == 1


@pytest.mark.parametrize(
    ("change", "what"), [(_swap, "so its name must be stream-001-000.mcap"), (_lose, "stream 1 is missing")]
)
def test_heads_and_configuration_count_without_a_manifest(log: Path, change: Callable[[Path], None], what: str) -> None:
    (log / artefacts.MANIFEST).unlink()
    change(log)
    assert any(what in fault for fault in info_tables(log)[1])
    with pytest.raises(ArtefactError, match=what):
        open_logs(log)


def test_a_stream_of_another_run_is_named(log: Path, make_log: Callable[..., Path]) -> None:
    (log / artefacts.MANIFEST).unlink()
    other = make_log(lengths=((3,), (4,)), seed=8)
    shutil.copy(other / "stream-001-000.mcap", log / "stream-001-000.mcap")
    with pytest.raises(ArtefactError, match="another run"):
        open_logs(log)


def test_a_manifest_that_is_no_manifest_is_refused(log: Path) -> None:
    (log / artefacts.MANIFEST).write_text(json.dumps({"x": 1}))
    with pytest.raises(ArtefactError):
        open_logs(log)
