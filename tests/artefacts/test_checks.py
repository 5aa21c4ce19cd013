"""Checking an artefact: whatever is missing, changed, extra, linked or oddly named is found and told."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.errors import ArtefactError
from gym_open.files import sha256_file


def _work(partial: Path) -> Mapping[str, Any]:
    (partial / "data").mkdir()
    (partial / "data" / "numbers.txt").write_text("0 1 2")
    return {}


def _make(out: Path) -> artefacts.Outcome:
    return artefacts.build(out, kind="toy", config=Config(), parents=(), work=_work)


def test_every_flipped_bit_position_of_every_file_is_found(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    for path in [p for p in out.rglob("*") if p.is_file() and p.name != "manifest.json"]:
        good = path.read_bytes()
        for position in range(0, len(good), max(1, len(good) // 7)):
            bad = bytearray(good)
            bad[position] ^= 1
            path.write_bytes(bytes(bad))
            with pytest.raises(ArtefactError, match=path.name):
                artefacts.verify(out)
        path.write_bytes(good)
    artefacts.verify(out)


def test_a_damaged_artefact_is_not_taken_for_up_to_date(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    (out / "data" / "numbers.txt").write_text("0 1 3")
    with pytest.raises(ArtefactError, match=r"numbers\.txt: .*remove the folder"):
        _make(out)


def test_missing_extra_and_linked_files_are_found(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    (out / "stray").write_text("x")
    with pytest.raises(ArtefactError, match="stray: not listed"):
        artefacts.verify(out)
    (out / "stray").unlink()
    (out / "link").symlink_to(out / "config.json")
    with pytest.raises(ArtefactError, match="links"):
        artefacts.verify(out)
    (out / "link").unlink()
    (out / "data" / "numbers.txt").unlink()
    with pytest.raises(ArtefactError, match=r"numbers\.txt: missing"):
        artefacts.verify(out)


def found(out: Path) -> dict[str, str]:
    return {problem.file: problem.what for problem in artefacts.problems(out)}


def test_problems_are_all_there_are(tmp_path: Path) -> None:
    """Missing, changed, of another size, extra, linked, special, empty folders: each once, with what is wrong."""
    out = _make(tmp_path / "a").path
    assert found(out) == {}
    (out / "data" / "numbers.txt").unlink()
    (out / "data" / "more").write_text("x")
    config = (out / "config.json").read_bytes()
    (out / "config.json").write_bytes(config[::-1])
    (out / "lineage.json").write_bytes((out / "lineage.json").read_bytes() + b" ")
    (out / "link").symlink_to("/etc")
    os.mkfifo(out / "pipe")
    (out / "empty" / "empty").mkdir(parents=True)
    told = found(out)
    assert told.pop("data/numbers.txt").startswith("missing")
    assert told.pop("data/more").startswith("not listed")
    assert "SHA-256" in told.pop("config.json")
    assert "bytes, manifest.json says" in told.pop("lineage.json")
    assert told.pop("link") == told.pop("pipe")
    assert told.pop("empty") == told.pop("empty/empty") == "a folder without a file in it; remove it"
    assert told == {}


def test_files_behind_a_linked_folder_are_missing(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    (out / "data").rename(tmp_path / "elsewhere")
    (out / "data").symlink_to(tmp_path / "elsewhere")
    told = found(out)
    assert set(told) == {"data", "data/numbers.txt"}
    assert "missing" in told["data/numbers.txt"]


@pytest.mark.parametrize("name", ["../x", "/x", "a/../x", "a//x", ".", "", ".hidden", "a\\x", "a b", "a;b", "é", "a\n"])
def test_names_that_leave_the_folder_or_are_odd_are_told(name: str, tmp_path: Path) -> None:
    """Even if there is such a file, and its bytes are as the manifest says."""
    out = _make(tmp_path / "a").path
    (tmp_path / "x").write_text("mine")
    manifest = {**artefacts.manifest(out), name: artefacts.Entry(sha256_file(tmp_path / "x"), 4)}
    (out / "manifest.json").write_bytes(artefacts.canonical_json(manifest))
    with pytest.raises(ArtefactError, match="may not list"):
        artefacts.verify(out)


def test_a_manifest_written_otherwise_is_told(tmp_path: Path) -> None:
    """The same files in another order, with another space, a key twice, or a field more."""
    out = _make(tmp_path / "a").path
    path = out / "manifest.json"
    good = path.read_bytes()
    entries = json.loads(good)
    more = {name: {**entry, "trust": True} for name, entry in entries.items()}
    twice = good.replace(b"{", b'{\n "config.json": {"sha256": "", "bytes": 0},', 1)
    for bad in (json.dumps(entries).encode(), good + b" ", twice, artefacts.canonical_json(more)):
        path.write_bytes(bad)
        assert list(found(out)) == ["manifest.json"]


def test_a_signature_is_no_stray_file_of_a_release_alone(tmp_path: Path) -> None:
    def make(kind: str) -> Path:
        return artefacts.build(tmp_path / kind, kind=kind, config=Config(), parents=(), work=lambda _: {}).path

    for kind, expected in (("release", []), ("log", ["signature.json"])):
        out = make(kind)
        (out / "signature.json").write_text("{}")
        assert list(found(out)) == expected
        (out / "signature.json").unlink()
        (out / "signature.json").symlink_to("config.json")
        assert list(found(out)) == ["signature.json"]


def test_a_signature_that_is_none_by_its_size_is_not_read(tmp_path: Path) -> None:
    out = artefacts.build(tmp_path / "a", kind="release", config=Config(), parents=[], work=lambda _: {}).path
    for size, expected in ((2**20, []), (2**20 + 1, ["signature.json"]), (3 * 2**30, ["signature.json"])):
        with (out / "signature.json").open("wb") as file:
            file.truncate(size)  # sparse: it takes no space
        assert [problem.file for problem in artefacts.problems(out)] == expected


def test_only_sizes_are_looked_at_where_no_hash_is_asked_for(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    (out / "data" / "numbers.txt").write_text("9 9 9")
    assert artefacts.verify(out, hashed=lambda name: not name.startswith("data/")) == artefacts.digest(out)
    (out / "data" / "numbers.txt").write_text("9 9")
    with pytest.raises(ArtefactError, match=r"numbers\.txt: 3 bytes, manifest\.json says 5"):
        artefacts.verify(out, hashed=lambda name: not name.startswith("data/"))


@pytest.mark.parametrize("record", ["manifest.json", "lineage.json", "config.json"])
def test_records_that_are_links_or_huge_are_not_read(record: str, tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    (out / record).unlink()
    (out / record).symlink_to("/dev/zero")
    with pytest.raises(ArtefactError, match=r"link|missing"):
        artefacts.verify(out, "toy")
    (out / record).unlink()
    with (out / record).open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(ArtefactError, match=r"over 67,108,864 bytes|bytes, manifest\.json says"):
        artefacts.verify(out, "toy")
