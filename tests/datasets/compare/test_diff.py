"""What changed between releases: real ones, and tables of episodes made by hand."""

import io
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from gym_open import artefacts
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.compare.diff import (
    Diff,
    FileChange,
    _feature_meanings,
    check_version,
    diff_releases,
    diff_tables,
)
from gym_open.datasets.compare.episode_diff import episode_meanings
from gym_open.datasets.compare.versions import Meaning
from gym_open.datasets.config import ReleaseConfig
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.releases.info import read_info

pytestmark = pytest.mark.usefixtures("no_figures")
MakeLog = Callable[..., Path]
FIRST = ReleaseConfig(max_episode_steps=5, val_fraction=0.34)


@pytest.fixture(scope="module")
def logs(make_log: MakeLog) -> list[Path]:
    return [make_log(), make_log(lengths=((6, 9), (3,)), seed=1)]


@pytest.fixture(scope="module")
def first(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(FIRST, logs[:1], tmp_path_factory.mktemp("diff") / "1.0.0").path)


def config(**changes: Any) -> ReleaseConfig:
    return msgspec.structs.replace(FIRST, **changes)


def edited(release: Release, folder: Path) -> Path:
    """A copy that is not sealed yet, to change by hand."""
    shutil.copytree(release.root, folder)
    (folder / artefacts.MANIFEST).unlink()
    return folder


def unsealed(folder: Path) -> Release:
    return Release(folder, "", read_info(folder))


def set_info(folder: Path, **ours: Any) -> None:
    path = folder / "meta/info.json"
    info = msgspec.json.decode(path.read_bytes())
    info["gym_open"].update(ours)
    path.write_bytes(artefacts.canonical_json(info))


def shown(diff: Diff) -> str:
    console = Console(file=io.StringIO(), width=200)
    for table in diff_tables(diff):
        console.print(table)
    return cast(io.StringIO, console.file).getvalue()


def test_the_same_again_is_refused(first: Release, logs: list[Path]) -> None:
    with pytest.raises(ArtefactError, match=r"nothing but version and date .*keep 1\.0\.0"):
        build_release(config(version="1.0.1", published="2026-01-02"), logs[:1], first.root.with_name("1.0.1"))
    assert not first.root.with_name("1.0.1").exists()
    assert diff_releases(first, first).bump == "none"


def test_an_append_is_minor(first: Release, logs: list[Path]) -> None:
    with pytest.raises(UsageError, match=r"version 2\.0\.0: .*give --version 1\.1\.0"):
        build_release(config(version="2.0.0"), logs[1:], first.root.with_name("2.0.0"), append=True)
    made = open_release(
        build_release(config(version="1.1.0"), logs[1:], first.root.with_name("1.1.0"), append=True).path
    )
    diff = check_version(first, made)
    count = len(made.episodes) - len(first.episodes)
    assert (diff.bump, diff.next_version) == ("minor", "1.1.0")
    assert f"{count} episodes appended ({len(first.episodes)}–{len(made.episodes) - 1})" in shown(diff)
    changed = {item.path for item in diff.files if item.how == "changed"}
    assert not {path for path in changed if path.endswith(".parquet")}, "old files stay"
    assert {"data/chunk-002/file-000.parquet"} <= {item.path for item in diff.files if item.how == "added"}
    back = diff_releases(made, first)
    assert (back.bump, back.next_version) == ("major", "2.0.0")
    assert f"{count} episodes removed" in shown(back)
    shutil.rmtree(made.root)


def test_other_episodes_are_major(first: Release, logs: list[Path], tmp_path: Path) -> None:
    other = open_release(build_release(config(version="1.0.1", max_episode_steps=6), logs[:1], tmp_path / "1.0.1").path)
    diff = diff_releases(first, other)
    assert diff.bump == "major"
    assert "settings: max_episode_steps" in {item.text for item in diff.meanings}


def test_another_licence_is_a_patch(first: Release, logs: list[Path]) -> None:
    out = first.root.with_name("1.0.1")
    made = open_release(build_release(config(version="1.0.1", license="cc0-1.0"), logs[:1], out).path)
    diff = check_version(first, made)
    assert diff.meanings[0].text == "licence: mit → cc0-1.0"
    assert "LICENSE" in next(item.text for item in diff.meanings if item.text.startswith("card"))
    shutil.rmtree(out)


def test_other_bytes_of_the_same_content_are_a_patch(first: Release, tmp_path: Path) -> None:
    folder = edited(first, tmp_path / "1.0.1")
    path = folder / "data/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(path), path, compression="none", use_dictionary=False)
    set_info(folder, version="1.0.1")
    diff = check_version(first, unsealed(folder))
    assert diff.bump == "patch"
    assert [(item.path, item.how) for item in diff.files if item.how == "serialisation"] == [
        ("data/chunk-000/file-000.parquet", "serialisation")
    ]
    assert "same content, other bytes" in shown(diff)


def test_another_card_is_a_patch_but_for_version_and_date(first: Release, tmp_path: Path) -> None:
    folder = edited(first, tmp_path / "1.0.1")
    card = folder / "README.md"
    card.write_text(card.read_text().replace("1.0.0", "1.0.1"))
    set_info(folder, version="1.0.1", published="2026-05-06")
    assert diff_releases(first, unsealed(folder)).bump == "none"
    card.write_text(card.read_text() + "more\n")
    (change,) = diff_releases(first, unsealed(folder)).meanings
    assert (change.bump, change.text) == ("patch", "card: README.md")


@pytest.mark.parametrize(
    "name", ["rebuild/rebuild.sh", "rebuild/build.toml", "croissant.json", "CHANGELOG.md", "LICENSE"]
)
@pytest.mark.parametrize("version", ["1.0.0", "1.0.1"])
def test_any_other_paper_is_a_patch(first: Release, tmp_path: Path, name: str, version: str) -> None:
    folder = edited(first, tmp_path / version)
    set_info(folder, version=version)
    paper = folder / name
    text = paper.read_text().replace("1.0.0", version)
    paper.write_text(text)
    assert diff_releases(first, unsealed(folder)).bump == "none"
    paper.write_text(text.replace("MuJoCo", "evil", 1) if name.endswith("json") else f"{text}more\n")
    (change,) = diff_releases(first, unsealed(folder)).meanings
    assert (change.bump, change.text) == ("patch", f"card: {name}")


def test_a_table_that_says_other_things_is_major(first: Release, tmp_path: Path) -> None:
    folder = edited(first, tmp_path / "1.0.1")
    path = folder / "meta/switches/file-000.parquet"
    table = pq.read_table(path)
    pq.write_table(table.set_column(1, "step", [[7] * len(table)]), path, use_dictionary=False)
    digests = msgspec.json.decode((folder / "meta/digests.json").read_bytes())
    digests["files"]["meta/switches/file-000.parquet"] = "0" * 64
    (folder / "meta/digests.json").write_bytes(artefacts.canonical_json(digests))
    diff = diff_releases(first, unsealed(folder))
    assert diff.meanings[0].bump == "major"
    assert diff.meanings[0].text == "table switches: its content changed"


def test_a_digest_that_nothing_explains_is_major(first: Release, tmp_path: Path) -> None:
    folder = edited(first, tmp_path / "1.0.1")
    digests = msgspec.json.decode((folder / "meta/digests.json").read_bytes())
    (folder / "meta/digests.json").write_bytes(artefacts.canonical_json({**digests, "release": "0" * 64}))
    assert diff_releases(first, unsealed(folder)).bump == "major"


@pytest.mark.parametrize(
    "content", [b"{", b"[]", b'{"release": "\xff", "files": {}}', b'{"release": 1, "files": {}}', b"[" * 100_000]
)
def test_digests_that_are_none(first: Release, tmp_path: Path, content: bytes) -> None:
    folder = edited(first, tmp_path / "1.0.1")
    (folder / "meta/digests.json").write_bytes(content)
    with pytest.raises(ArtefactError, match=r"digests\.json"):
        diff_releases(first, unsealed(folder))


def test_another_name_follows_nothing(first: Release, tmp_path: Path) -> None:
    folder = edited(first, tmp_path / "1.0.1")
    set_info(folder, name="open/other", version="1.0.1")
    with pytest.raises(ArtefactError, match="open/explore"):
        check_version(first, unsealed(folder))


# Tables of episodes made by hand: a row is (identity, split), its place follows from the identity.


def made_by_hand(rows: list[tuple[int, str]], changed: dict[int, str] | None = None) -> Release:
    """Episodes of these identities and splits, in this order; of those in `changed`, a feature is another."""
    marks = changed or {}
    episodes = pd.DataFrame(
        {
            "episode_index": range(len(rows)),
            "puzzle": [f"p{n % 3}" for n, _ in rows],
            "explorer": "icm",
            "world": [n % 3 for n, _ in rows],
            "steps": [n + 1 for n, _ in rows],
            "continued": False,
            "ended": "learned",
            "split": [split for _, split in rows],
            "stream": 0,
            "segment": [n for n, _ in rows],
            "piece": 0,
            "first_step": [10 * n for n, _ in rows],
        }
    )
    content = pd.DataFrame(
        {
            "episode_index": range(len(rows)),
            "action": [f"a{n}" for n, _ in rows],
            "observation.image": [marks.get(n, f"i{n}") for n, _ in rows],
        }
    )
    return cast(Release, SimpleNamespace(root=Path("r"), episodes=episodes, table=lambda _: content))


def meanings(
    a: Release, b: Release, features: tuple[str, ...] = ("action", "observation.image")
) -> list[tuple[str, str]]:
    return [(item.bump, item.text) for item in episode_meanings(a, b, features)]


OLD = [(n, "train") for n in range(6)]


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (OLD, []),
        ([*OLD, (6, "train"), (7, "val")], [("minor", "2 episodes appended (6–7)")]),
        (OLD[:-1], [("major", "1 episode removed (5)")]),
        ([OLD[1], OLD[0], *OLD[2:]], [("major", "episodes reordered")]),
        ([*OLD[:2], (2, "val"), *OLD[3:]], [("major", "1 episode moved to another split (2)")]),
        ([(6, "train"), *OLD], [("major", "1 episode inserted before old ones (0)")]),
        ([*OLD[:-1], (6, "train"), OLD[-1]], [("major", "1 episode inserted before old ones (5)")]),
        (
            [*OLD[1:], (6, "train")],
            [("major", "1 episode removed (0)"), ("minor", "1 episode added after the old ones (5)")],
        ),
    ],
)
def test_episodes(rows: list[tuple[int, str]], expected: list[tuple[str, str]]) -> None:
    assert meanings(made_by_hand(OLD), made_by_hand(rows)) == expected


@pytest.mark.parametrize(
    ("fact", "value"),
    [("puzzle", "p9"), ("explorer", "rnd"), ("world", 9), ("steps", 9), ("continued", True), ("ended", "budget")],
)
def test_an_episode_of_another_fact_is_changed(fact: str, value: Any) -> None:
    new = made_by_hand(OLD)
    new.episodes[fact] = new.episodes[fact].where(new.episodes.index != 2, value)
    assert meanings(made_by_hand(OLD), new) == [("major", f"1 episode changed (2): {fact}")]


def test_changed_episodes_name_the_features() -> None:
    new = made_by_hand(OLD, {1: "other", 2: "other", 4: "other"})
    assert meanings(made_by_hand(OLD), new) == [("major", "3 episodes changed (1–2, 4): observation.image")]
    assert meanings(made_by_hand(OLD), new, ("action",)) == [], "only features that both have count"


@settings(max_examples=25)
@given(st.lists(st.integers(0, 8), unique=True, max_size=9), st.randoms(use_true_random=False))
def test_only_additions_at_the_end_are_less_than_major(kept: list[int], rng: random.Random) -> None:
    old = [(n, "train") for n in range(9)]
    new = [(n, "train") for n in kept] + [(n, "val") for n in range(9, 9 + rng.randrange(3))]
    found = {bump for bump, _ in meanings(made_by_hand(old), made_by_hand(new))}
    assert ("major" in found) == (new[:9] != old)
    assert ("minor" in found) == (len(new) > len(kept))


def test_episodes_and_content_must_fit() -> None:
    wrong = made_by_hand(OLD)
    wrong.episodes["episode_index"] = wrong.episodes["episode_index"][::-1].to_numpy()
    with pytest.raises(ArtefactError, match="episode_index"):
        meanings(made_by_hand(OLD), wrong)


def test_features_added_removed_and_retyped(first: Release) -> None:
    def with_features(change: Callable[[dict[str, Any]], Any]) -> Release:
        info = msgspec.json.decode(msgspec.json.encode(first.info))
        change(info["features"])
        return Release(first.root, "", info)

    fewer = with_features(lambda features: features.pop("policy.value"))
    other = with_features(lambda features: features["policy.value"].update(dtype="float64"))
    for a, b, bump, text in (
        (first, fewer, "major", "feature removed: policy.value"),
        (fewer, first, "minor", "feature added: policy.value"),
        (first, other, "major", "feature retyped: policy.value"),
    ):
        assert [(item.bump, item.text) for item in _feature_meanings(a, b)] == [(bump, text)]


def test_what_a_file_says_steers_no_terminal() -> None:
    diff = Diff(
        "a 1.0.0", "b 1.0.1", "patch", "1.0.1", [FileChange("[red]x", "added")], [Meaning("patch", "\x1b[2J[b]")]
    )
    assert "\\x1b[2J[b]" in shown(diff)
    assert "[red]x" in shown(diff)
