"""Versions follow from what changed."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.datasets.compare.versions import RANK, implied, latest_below, parse
from gym_open.errors import ArtefactError

NUMBERS = st.integers(0, 99_999)


@pytest.mark.parametrize(
    ("bump", "expected"), [("none", "1.2.3"), ("patch", "1.2.4"), ("minor", "1.3.0"), ("major", "2.0.0")]
)
def test_implied(bump, expected: str) -> None:
    assert implied("1.2.3", bump) == expected


@given(NUMBERS, NUMBERS, NUMBERS)
def test_weightier_bumps_give_higher_versions(major: int, minor: int, patch: int) -> None:
    version = f"{major}.{minor}.{patch}"
    found = [parse(implied(version, bump)) or (0, 0, 0) for bump in sorted(RANK, key=lambda bump: RANK[bump])]
    assert found[0] == (major, minor, patch)
    assert found == sorted(set(found))


@pytest.mark.parametrize("text", ["1.0", "1.0.0.0", "01.0.0", "1.0.-1", "v1.0.0", "1.0.0\n", "", "１.0.0"])
def test_what_is_no_version(text: str) -> None:
    assert parse(text) is None
    with pytest.raises(ArtefactError, match="three numbers"):
        implied(text, "patch")


def test_latest_below_goes_by_numbers_and_by_folders_alone(tmp_path: Path) -> None:
    for name in ("0.9.0", "1.2.0", "1.10.0", "2.0.0", "1.11", ".1.10.5.partial", "1.10.1-1"):
        (tmp_path / name).mkdir()
    (tmp_path / "1.10.9").write_text("no folder")
    assert latest_below(tmp_path / "1.11.0", "1.11.0") == tmp_path / "1.10.0"
    assert latest_below(tmp_path / "1.10.0", "1.10.0") == tmp_path / "1.2.0"
    assert latest_below(tmp_path / "0.1.0", "0.1.0") is None
    assert latest_below(tmp_path / "2.0.0", "3.0.0") == tmp_path / "1.10.0", "a release does not follow itself"
    assert latest_below(tmp_path / "draft", "1.10.0") == tmp_path / "1.2.0", "nor its equal"
    assert latest_below(tmp_path / "missing/1.0.0", "1.0.0") is None
