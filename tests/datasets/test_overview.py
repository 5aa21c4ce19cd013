"""Releases at a glance."""

import io
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console
from rich.table import Table

from gym_open import artefacts
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.overview import info_tables, list_table
from gym_open.errors import ArtefactError
from gym_open.formats.releases.content import payload_digest

pytestmark = pytest.mark.usefixtures("no_figures")


@pytest.fixture(scope="module")
def release(make_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Release:
    folder = tmp_path_factory.mktemp("datasets") / "open/explore"
    return open_release(build_release(ReleaseConfig(max_episode_steps=5), [make_log()], folder / "1.0.0").path)


def shown(*tables: Table) -> str:
    console = Console(file=io.StringIO(), width=300)
    for table in tables:
        console.print(table)
    return console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]


def rows(table: Table) -> list[list[str]]:
    return [list(row) for row in zip(*(column.cells for column in table.columns), strict=True)]  # type: ignore[arg-type]


def test_info(release: Release) -> None:
    facts, splits, explorers, features = info_tables(release.root)
    told = dict(rows(facts))
    assert told["frames"] == f"{len(release)} in {len(release.episodes)} episodes"
    assert told["digest"] == release.digest
    assert told["payload digest"] == payload_digest(artefacts.manifest(release.root))
    assert sum(int(row[2]) for row in rows(splits)) == len(release)
    assert [row[0] for row in rows(explorers)] == ["unknown"]
    assert [row[0] for row in rows(features)] == list(release.info["features"])


def test_info_of_what_is_no_release(tmp_path: Path, make_log: Callable[..., Path]) -> None:
    with pytest.raises(ArtefactError, match="not an artefact"):
        info_tables(tmp_path)
    with pytest.raises(ArtefactError, match="kind 'release', got 'log'"):
        info_tables(make_log(lengths=((2,),), seed=9))


def test_list_shows_whole_and_damaged_ones_and_nothing_else(release: Release, tmp_path: Path) -> None:
    for name in ("a/b/1.10.0", "a/b/1.9.0", "damaged/[red]x/1.0.0", "a/.1.0.0.partial"):
        shutil.copytree(release.root, tmp_path / name)
    (tmp_path / "damaged/[red]x/1.0.0/meta/info.json").write_text("{")
    (tmp_path / "empty").mkdir()
    (tmp_path / "log").mkdir()
    artefact = artefacts.canonical_json(artefacts.lineage(release.root)).replace(b'"release"', b'"log"', 1)
    (tmp_path / "log/lineage.json").write_bytes(artefact)
    (tmp_path / "link").symlink_to(release.root)
    table = list_table(tmp_path)
    found = {row[-1]: row for row in rows(table)}
    assert set(found) == {"a/b/1.10.0", "a/b/1.9.0", "damaged/\\[red]x/1.0.0"}
    whole = found["a/b/1.9.0"]
    assert whole[:4] == ["open/explore 1.0.0", str(len(release)), str(len(release.episodes)), "1"]
    assert whole[5] == release.digest[:8]
    assert "damaged: " in shown(table)
    assert "info.json" in shown(table)
    assert "[red]x" in shown(table)


def test_list_of_a_release_is_that_release(release: Release) -> None:
    assert [row[-1] for row in rows(list_table(release.root))] == ["."]


def test_list_of_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="no such folder"):
        list_table(tmp_path / "missing")
    assert rows(list_table(tmp_path)) == []
