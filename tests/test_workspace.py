"""Workspaces are made whole; a folder that is no workspace is refused by name."""

from pathlib import Path

import pytest

from gym_open import workspace
from gym_open.errors import UsageError


def test_init_makes_a_workspace_with_every_default_configuration(tmp_path: Path) -> None:
    written = workspace.init(tmp_path / "w")
    assert workspace.check(tmp_path / "w") == tmp_path / "w"
    for name in ("collect/curl-ride.toml", "evaluate/goal-seeking.toml", "train/README.md"):
        assert (tmp_path / "w" / name) in written
        assert (tmp_path / "w" / name).read_bytes() == (workspace.template() / name).read_bytes()
    assert not list((tmp_path / "w").rglob("*.py"))


def test_init_never_changes_existing_folders(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    with pytest.raises(UsageError, match="train: exists already"):
        workspace.init(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["train"]


def test_check_names_the_missing_folder_and_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no folder 'collect'.*gym-open init"):
        workspace.check(tmp_path)
