"""What `datasets/published` says of releases is what its own records say; and play from seeds gives a known release."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gym_open import artefacts
from gym_open.cli import main
from gym_open.datasets.compact.restore import restore_release
from gym_open.files import sha256_file
from gym_open.formats.compact import open_compact
from gym_open.formats.releases.content import episode_digest, payload_digest
from gym_open.formats.releases.layout import RECORDS, belongs
from gym_open.replay.compact.player import CompactPlayer, stored_episodes
from gym_open.replay.compact.release import CompactRelease, content_of
from gym_open.workspace import template

PUBLISHED = template() / "datasets/published"
RELEASES = sorted(path.parent.parent for path in PUBLISHED.glob("*/*/*/meta/info.json"))
COMPACT = sorted(path.parent for path in PUBLISHED.glob("*/*/*/compact.json"))

REDUCED = "fcb21ecfd259e436aeb20da2f66015ef0f0fa5708a987b8cd92e5905ddbe3a5c"
"""Of the frames in the release of 256 steps of plain random play, seed 0, as they came out when it was first made.
A release's own digest also covers its settings, which grow with the code."""


def test_there_is_a_release() -> None:
    assert [path.relative_to(PUBLISHED).as_posix() for path in RELEASES] == ["open/explore-mini/1.0.0"]


@pytest.mark.parametrize("root", RELEASES, ids=lambda path: path.relative_to(PUBLISHED).as_posix())
def test_what_is_kept_of_it_is_what_its_manifest_lists(root: Path) -> None:
    entries = artefacts.manifest(root)
    kept = {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()} - {artefacts.MANIFEST}
    assert kept >= {
        "README.md",
        "croissant.json",
        "meta/digests.json",
        "meta/stats.json",
        "rebuild/rebuild.sh",
        *RECORDS,
    } - {artefacts.MANIFEST}
    for name in kept:
        assert belongs(name)
        assert sha256_file(root / name) == entries[name].sha256
    digests = msgspec.json.decode((root / "meta/digests.json").read_bytes())
    row = next(line for line in (PUBLISHED / "README.md").read_text().splitlines() if payload_digest(entries) in line)
    assert digests["release"] in row


def test_there_is_a_compact_release() -> None:
    assert [path.relative_to(PUBLISHED).as_posix() for path in COMPACT] == ["open/play/1.0.0"]


@pytest.mark.parametrize("root", COMPACT, ids=lambda path: path.relative_to(PUBLISHED).as_posix())
def test_a_compact_release_is_what_the_page_says_and_plays_as_it_did(root: Path) -> None:
    """The first two episodes of every explorer; `gym-open dataset verify` plays all of them."""
    compact = open_compact(root)
    row = next(line for line in (PUBLISHED / "README.md").read_text().splitlines() if compact.info.payload in line)
    assert compact.info.content in row
    assert f"{compact.info.steps:,} steps" in row
    assert sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) < 40e6
    release = CompactRelease(compact)
    explorers = release.episodes.groupby("explorer").head(2)["episode_index"].tolist()
    numbers = {number: play for play, (number, _) in enumerate(compact.numbers)}
    player = CompactPlayer(compact)
    wanted = {numbers[number] for number in explorers}
    for stored in stored_episodes(compact):
        if stored.number in wanted:
            found = content_of(player.play(stored))
            assert episode_digest(found, release.rows[compact.numbers[stored.number][0]]) == stored.row.digest


@pytest.mark.slow
@pytest.mark.parametrize("root", COMPACT, ids=lambda path: path.relative_to(PUBLISHED).as_posix())
def test_a_compact_release_is_restored_in_every_byte(root: Path, tmp_path: Path) -> None:
    found = restore_release(root, tmp_path / "release")
    assert found.different == []
    assert artefacts.digest(found.path) == open_compact(root).info.release


def _make(work: Path, workers: int) -> Path:
    """Play and release, by the commands alone."""
    log, release = work / "log", work / "open/reduced/1.0.0"
    settings = ["--config", str(template() / "collect/random.toml"), "--seed", "0"]
    assert (
        main(
            ["collect", *settings, "--steps", "256", "--streams", "2", "--curriculum.interval", "64", "--out", str(log)]
        )
        == 0
    )
    words = ["--config", str(template() / "datasets/explore-mini.toml"), "--logs", str(log), "--workers", str(workers)]
    assert main(["dataset", "build", *words, "--name", "open/reduced", "--out", str(release)]) == 0
    return release


def _content(release: Path) -> Mapping[str, Any]:
    return msgspec.json.decode((release / "meta/digests.json").read_bytes())


def test_from_a_seed_comes_the_same_release_anywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other = _make(tmp_path / "a", 1), _make(tmp_path / "another place", 3)
    assert re.search(r"made .*1\.0\.0", " ".join(capsys.readouterr().out.split()))
    assert artefacts.digest(one) == artefacts.digest(other)
    assert _content(one)["files"]["meta/content/file-000.parquet"] == REDUCED
