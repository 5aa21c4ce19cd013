"""The changelog: this version's section before all earlier ones; the licence."""

import shutil
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.compare.diff import diff_releases
from gym_open.datasets.compare.payload import digests
from gym_open.datasets.config import Header, ReleaseConfig
from gym_open.datasets.documents.changelog import changelog
from gym_open.datasets.documents.licences import URLS, licence_text
from gym_open.errors import ArtefactError
from gym_open.formats.releases.info import read_info

pytestmark = pytest.mark.usefixtures("no_figures")
CONFIG = ReleaseConfig(name="open/changes", max_episode_steps=5, val_fraction=0.34)


@pytest.fixture(scope="module")
def first(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(build_release(CONFIG, logs[:1], tmp_path_factory.mktemp("changes") / "1.0.0").path)


def test_a_first_release_says_so(first: Release) -> None:
    text = (first.root / "CHANGELOG.md").read_text()
    content = digests(first.root).release
    assert text == f"# Changelog of open/changes\n\n## 1.0.0\n\nFirst release.\n\nContent digest `{content}`.\n"


def test_sections_pile_up(first: Release, logs: list[Path]) -> None:
    second = msgspec.structs.replace(CONFIG, version="1.1.0", published="2026-03-04")
    made = build_release(second, logs[1:], first.root.with_name("1.1.0"), append=True).path
    text = (made / "CHANGELOG.md").read_text()
    assert [line for line in text.splitlines() if line.startswith("#")] == [
        "# Changelog of open/changes", "## 1.1.0 (2026-03-04)", "## 1.0.0",
    ]  # fmt: skip
    assert "A minor change since 1.0.0:\n\n- " in text
    assert " appended (" in text
    assert text.endswith((first.root / "CHANGELOG.md").read_text().split("\n\n", 1)[1])
    shutil.rmtree(made)


@pytest.mark.parametrize("content", [b"\xff\xfe", b"x" * (2**20 + 1), None])
def test_an_earlier_changelog_that_is_none(first: Release, tmp_path: Path, content: bytes | None) -> None:
    folder = tmp_path / "1.0.0"
    shutil.copytree(first.root, folder)
    (folder / "CHANGELOG.md").unlink()
    if content is not None:
        (folder / "CHANGELOG.md").write_bytes(content)
    earlier = Release(folder, "", read_info(folder))
    with pytest.raises(ArtefactError, match=r"CHANGELOG\.md"):
        changelog(Header(name="open/changes", version="1.0.1"), first, earlier, diff_releases(earlier, first))


@pytest.mark.parametrize("spdx", sorted(URLS))
def test_licences(spdx: Any) -> None:
    text = licence_text(Header(name="me/mine", license=spdx, published="2026-01-02"))
    assert "the authors of me/mine" in text
    assert "2026" not in text, "the text is the same in any year"
    assert spdx == "mit" or f"{URLS[spdx]}legalcode" in text
