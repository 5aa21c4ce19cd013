"""Artefacts: whole or absent, byte-checked, reproducible anywhere, resumable."""

import fcntl
import hashlib
import json
import resource
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.errors import ArtefactError, UsageError
from gym_open.files import write_atomically


class Toy(Config, frozen=True, kw_only=True):
    n: int = 3


def _make(out: Path, config: Toy | None = None, parents: tuple[Path, ...] = ()) -> artefacts.Outcome:
    config = config or Toy()

    def work(partial: Path) -> Mapping[str, Any]:
        (partial / "data").mkdir()
        (partial / "data" / "numbers.txt").write_text(" ".join(map(str, range(config.n))))
        return {"n": config.n}

    return artefacts.build(out, kind="toy", config=config, parents=parents, work=work)


def test_made_once_then_up_to_date_then_made_again_when_an_input_changes(tmp_path: Path) -> None:
    out = tmp_path / "a"
    assert _make(out).made
    assert not _make(out).made
    again = _make(out, Toy(n=4))
    assert again.made
    assert (out / "data" / "numbers.txt").read_text() == "0 1 2 3"
    assert again.earlier == tmp_path / "a-1"
    assert (tmp_path / "a-1" / "data" / "numbers.txt").read_text() == "0 1 2"
    artefacts.verify(tmp_path / "a-1")
    assert _make(out, Toy(n=5)).earlier == tmp_path / "a-2"


def test_to_ask_whether_it_is_up_to_date_says_what_making_it_would_find(tmp_path: Path) -> None:
    parents = (_make(tmp_path / "p").path, _make(tmp_path / "q", Toy(n=7)).path)
    out = tmp_path / "a"

    def asked(config: Toy | None = None, inputs: tuple[Path, ...] = parents) -> bool:
        return artefacts.is_up_to_date(out, kind="toy", config=config or Toy(), parents=inputs)

    assert not asked()
    _make(out, parents=parents)
    assert asked()
    assert not asked(Toy(n=4))
    assert not asked(inputs=parents[::-1])
    assert not asked(inputs=(*parents, tmp_path / "none"))
    assert not artefacts.is_up_to_date(out, kind="other", config=Toy(), parents=parents)
    (out / "data" / "numbers.txt").write_text("0 1 3")
    assert not asked()


def test_the_digest_does_not_depend_on_the_place(tmp_path: Path) -> None:
    _make(tmp_path / "here" / "a")
    _make(tmp_path / "elsewhere" / "deep" / "b")
    assert artefacts.digest(tmp_path / "here" / "a") == artefacts.digest(tmp_path / "elsewhere" / "deep" / "b")


def test_the_manifest_lists_the_sha256_of_every_other_file(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    manifest = json.loads((out / "manifest.json").read_text())
    assert set(manifest) == {"config.json", "lineage.json", "data/numbers.txt"}
    for name, entry in manifest.items():
        assert hashlib.sha256((out / name).read_bytes()).hexdigest() == entry["sha256"]
    assert artefacts.digest(out) == hashlib.sha256((out / "manifest.json").read_bytes()).hexdigest()


def test_a_damaged_parent_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    parent = _make(tmp_path / "parent").path
    (parent / "data" / "numbers.txt").write_text("9 9 9")
    with pytest.raises(ArtefactError, match=r"numbers\.txt"):
        _make(tmp_path / "child", parents=(parent,))
    assert not (tmp_path / "child").exists()


def test_a_missing_parent_and_a_wrong_kind_are_named(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="nowhere: not an artefact"):
        _make(tmp_path / "child", parents=(tmp_path / "nowhere",))
    with pytest.raises(ArtefactError, match="expected an artefact of kind 'log', got 'toy'"):
        artefacts.verify(_make(tmp_path / "a").path, "log")


@pytest.fixture
def small_disk() -> Iterator[None]:
    """No file can have more than 1000 bytes, as if there were no more room."""
    usual, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, most))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (usual, most))


@pytest.mark.usefixtures("small_disk")
def test_a_full_disk_is_an_error_by_name_and_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_atomically(path, b"old")
    with pytest.raises(
        ArtefactError, match=r"summary\.json: cannot be written \(File too large\).*make room.*same command again"
    ):
        write_atomically(path, bytes(5000))
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"old"


@pytest.mark.usefixtures("small_disk")
def test_work_that_the_disk_has_no_room_for_is_an_error_by_name(tmp_path: Path) -> None:
    """Whatever wrote it: an error of writing has no file's name."""
    with pytest.raises(ArtefactError, match=r"\.a\.partial: cannot be written \(File too large\).*make room"):
        _make(tmp_path / "a", Toy(n=1000))
    assert not (tmp_path / "a").exists()


def test_records_nested_too_deeply_are_refused(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    (out / "config.json").write_text('{"a":' + "[" * 100_000 + "]" * 100_000 + "}")
    with pytest.raises(ArtefactError, match=r"config\.json: not readable"):
        artefacts.config_of(out)


def test_a_folder_that_is_no_artefact_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years")
    with pytest.raises(ArtefactError, match="not an artefact"):
        _make(tmp_path / "mine")
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years"


def test_work_that_fails_leaves_no_artefact_and_the_next_call_goes_on_from_its_files(tmp_path: Path) -> None:
    seen: list[bool] = []

    def work(partial: Path) -> Mapping[str, Any]:
        seen.append((partial / "first").exists())
        (partial / "first").write_text("1")
        if len(seen) == 1:
            raise RuntimeError("killed")
        return {}

    def call() -> artefacts.Outcome:
        return artefacts.build(tmp_path / "a", kind="toy", config=Toy(), parents=(), work=work)

    with pytest.raises(RuntimeError, match="killed"):
        call()
    assert not (tmp_path / "a").exists()
    assert call().made
    assert seen == [False, True]
    assert not (tmp_path / "a" / artefacts.SCRATCH).exists()


@pytest.mark.parametrize(
    ("at", "earlier"), [("scratch", False), ("in scratch", False), ("rename", False), ("rename", True), ("aside", True)]
)
def test_a_kill_behind_the_seal_loses_no_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str, *, earlier: bool
) -> None:
    """Killed before, in or behind the removal of its checkpoint, or with the earlier artefact aside: it is renamed."""
    out, worked = tmp_path / "a", list[Path]()
    rmtree, rename = shutil.rmtree, Path.rename

    def work(partial: Path) -> Mapping[str, Any]:
        worked.append(partial)
        (partial / artefacts.SCRATCH / "state").write_text("hours")
        (partial / "weights").write_text("hours")
        return {}

    def removed(path: Path, **options: Any) -> None:
        if at == "in scratch":
            (path / "key").unlink()
        if "scratch" in at:
            raise KeyboardInterrupt
        rmtree(path, **options)

    def renamed(path: Path, target: Path) -> Path:
        if at == "rename" and path.name == ".a.partial":
            raise KeyboardInterrupt
        moved = rename(path, target)
        if at == "aside" and path == out:
            raise KeyboardInterrupt
        return moved

    if earlier:
        _make(out)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", removed)
        patch.setattr(Path, "rename", renamed)
        with pytest.raises(KeyboardInterrupt):
            artefacts.build(out, kind="toy", config=Toy(n=4), parents=(), work=work)
    assert artefacts.build(out, kind="toy", config=Toy(n=4), parents=(), work=work).made
    assert len(worked) == 1
    artefacts.verify(out, "toy")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "a-1"][: 1 + earlier]


def test_a_sealed_folder_that_was_damaged_is_not_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(path: Path, target: Path) -> Path:
        if path.name == ".a.partial":
            raise KeyboardInterrupt
        return rename(path, target)

    rename = Path.rename
    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", killed)
        with pytest.raises(KeyboardInterrupt):
            _make(tmp_path / "a")
    (tmp_path / ".a.partial" / "data" / "numbers.txt").write_text("0 1 3")
    with pytest.raises(ArtefactError, match=r"numbers\.txt.*remove the folder .*\.a\.partial and run"):
        _make(tmp_path / "a")


def test_unfinished_work_of_other_inputs_is_set_aside_not_lost(tmp_path: Path) -> None:
    def fail(partial: Path) -> Mapping[str, Any]:
        (partial / "precious").write_text("hours")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError):
        artefacts.build(tmp_path / "a", kind="toy", config=Toy(), parents=(), work=fail)
    _make(tmp_path / "a", Toy(n=5))
    assert [p.read_text() for p in tmp_path.glob(".a.partial-*/precious")] == ["hours"]


def test_where_nothing_can_be_written_is_said_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")

    def build(out: Path) -> None:
        artefacts.build(out, kind="toy", config=Toy(), parents=(), work=lambda _: pytest.fail("work was begun"))

    for out in (tmp_path / "file/a", tmp_path / "file/deep/a"):
        with pytest.raises(UsageError, match=rf"{out}: cannot be made: {tmp_path}/file is not a folder .*other --out"):
            build(out)
    with pytest.raises(UsageError, match=r"/proc/a: cannot be made: nothing new can be made in /proc .*other --out"):
        build(Path("/proc/a"))
    assert (tmp_path / "file").read_text() == "mine"


def test_two_writers_of_the_same_artefact_are_refused(tmp_path: Path) -> None:
    with (tmp_path / ".a.lock").open("w") as held:  # a lock belongs to an open file: this stands for another process
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(UsageError, match="another gym-open process"):
            _make(tmp_path / "a")
    assert _make(tmp_path / "a").made


def test_a_parents_records_prove_themselves_and_a_forged_one_does_not(tmp_path: Path) -> None:
    child = _make(tmp_path / "child", parents=(_make(tmp_path / "parent").path,)).path
    (parent,) = artefacts.lineage(child).parents
    assert parent.is_consistent()
    record = json.loads((child / "lineage.json").read_text())
    record["parents"][0]["lineage"]["facts"]["n"] = 99
    (child / "lineage.json").write_bytes(artefacts.canonical_json(record))
    (forged,) = artefacts.lineage(child).parents
    assert not forged.is_consistent()


def test_no_place_or_time_in_the_records(tmp_path: Path) -> None:
    out = _make(tmp_path / "a").path
    records = b"".join((out / name).read_bytes() for name in ("config.json", "lineage.json", "manifest.json"))
    assert str(tmp_path).encode() not in records
    shutil.rmtree(out)
    again = _make(tmp_path / "a").path
    assert records == b"".join((again / name).read_bytes() for name in ("config.json", "lineage.json", "manifest.json"))
