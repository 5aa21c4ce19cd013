"""Whatever happens to the bytes of a release by accident is found, and the file is named."""

import io
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from gym_open.datasets import signing
from gym_open.datasets.verify import VerificationReport, verify_release
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.releases import open_release

Quick = Callable[[Path], VerificationReport]
Damage = Callable[[Path, Path, np.random.Generator], str]


def flip(root: Path, file: Path, rng: np.random.Generator) -> str:
    data = bytearray(file.read_bytes())
    data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    file.write_bytes(data)
    return file.relative_to(root).as_posix()


def truncate(root: Path, file: Path, rng: np.random.Generator) -> str:
    os.truncate(file, int(rng.integers(file.stat().st_size)))
    return file.relative_to(root).as_posix()


def delete(root: Path, file: Path, _: np.random.Generator) -> str:
    file.unlink()
    return file.relative_to(root).as_posix()


def add(root: Path, file: Path, rng: np.random.Generator) -> str:
    stray = file.with_name(f"{rng.choice(['file-007', '.hidden', 'copy of', 'x;y'])}{file.suffix}")
    stray.write_bytes(rng.bytes(int(rng.integers(1, 99))))
    return stray.relative_to(root).as_posix()


def swap(root: Path, file: Path, _: np.random.Generator) -> str:
    """The same bytes, but behind a link."""
    elsewhere = root.parent / "elsewhere"
    shutil.move(file, elsewhere)
    file.symlink_to(elsewhere)
    return file.relative_to(root).as_posix()


def swap_folder(root: Path, file: Path, _: np.random.Generator) -> str:
    folder = file.parent if file.parent != root else root / "data"
    elsewhere = root.parent / "elsewhere"
    shutil.move(folder, elsewhere)
    folder.symlink_to(elsewhere)
    return folder.relative_to(root).as_posix()


def restore(root: Path, good: Path, name: str) -> None:
    """Make a file or folder what it was."""
    target, elsewhere = root / name, root.parent / "elsewhere"
    if target.is_symlink() or not (good / name).exists():
        target.unlink()
    if elsewhere.exists():
        shutil.move(elsewhere, target)
    elif (good / name).exists():
        shutil.copyfile(good / name, target)


@pytest.mark.parametrize("damage", [flip, truncate, delete, add, swap, swap_folder])
def test_damage_is_found_and_named(damage: Damage, made_up: Path, release: Path, quick: Quick) -> None:
    """200 in all. Some of the manifest's bytes make it say otherwise of another file, which is then named with it."""
    rng = np.random.default_rng(list(damage.__name__.encode()))
    names = sorted(path.relative_to(release) for path in release.rglob("*") if path.is_file())
    for _ in range(34):
        named = damage(release, release / names[rng.integers(len(names))], rng)
        report = quick(release)
        assert not report.good
        assert report.verdict.startswith("NOT verified")
        assert any(named in words for problem in report.problems for words in (problem.file, problem.what)), named
        restore(release, made_up, named)
    assert quick(release).good


def test_what_is_whole_is_said_to_be(made_up: Path, quick: Quick) -> None:
    report = quick(made_up)
    assert (report.problems, report.good) == ([], True)
    assert [check.good for check in report.checks if check.name != "replay"] == [True] * 7
    assert len(report.content) == len(report.digest) == 64


def test_what_rests_on_something_unsound_is_not_checked(
    release: Path, quick: Quick, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> str:
        raise ArtefactError(f"{release / 'signature.json'}: of another key")

    monkeypatch.setattr(signing, "check_signature", refuse)
    report = quick(release)  # nothing rests on a signature
    assert [check.name for check in report.checks if check.good is not True] == ["signature", "replay"]
    assert [problem.file for problem in report.problems] == ["signature.json"]
    (release / "LICENSE").write_text("none")
    report = quick(release)
    assert [check.good for check in report.checks] == [False] + [None] * 7
    assert {check.outcome for check in report.checks[1:-1]} == {"not checked: an earlier check failed"}


def test_a_tolerance_or_folder_that_is_none_is_the_callers_mistake(release: Path, tmp_path: Path) -> None:
    for tolerance in (float("nan"), -1.0):
        with pytest.raises(UsageError, match="--tolerance: expected 0 or more"):
            verify_release(release, replay=False, tolerance=tolerance)
    with pytest.raises(UsageError, match="nowhere: no such folder"):
        verify_release(tmp_path / "nowhere")


def test_every_problem_is_told_not_only_the_first(release: Path, quick: Quick) -> None:
    (release / "README.md").write_text("x")
    (release / "LICENSE").unlink()
    (release / "stray").mkdir()
    (release / "data/chunk-000/pipe").mkdir()
    os.mkfifo(release / "meta/pipe")
    found = {problem.file for problem in quick(release).problems}
    assert found == {"README.md", "LICENSE", "stray", "data/chunk-000/pipe", "meta/pipe"}


def test_opening_reads_all_but_data_and_that_too_if_asked(release: Path) -> None:
    """A flipped bit in a data file has its size unchanged: it is found by `bytes`, and by `dataset verify`."""
    rng = np.random.default_rng(0)
    flip(release, release / "data/chunk-000/file-000.parquet", rng)
    open_release(release)
    with pytest.raises(ArtefactError, match=r"data/chunk-000/file-000\.parquet: its SHA-256"):
        open_release(release, check="bytes")
    flip(release, release / "meta/stats.json", rng)
    with pytest.raises(ArtefactError, match=r"meta/stats\.json: its SHA-256"):
        open_release(release)


def test_a_report_shows_what_a_hostile_name_says_and_does_not_follow_it(release: Path, quick: Quick) -> None:
    (release / "[red]\x1b[2Jx").write_text("x")
    report = quick(release)
    console = Console(record=True, width=200, file=io.StringIO())
    for table in report.tables():
        console.print(table)
    shown = console.export_text()
    assert "\x1b" not in shown + report.verdict
    assert r"[red]\x1b[2Jx" in shown
