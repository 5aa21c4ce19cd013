"""Where LeRobot is looked for, and what is said where it is not."""

import sys
from pathlib import Path

import pytest

from gym_open.datasets.verify import VerificationReport, verify_release
from gym_open.datasets.verify.readers import VARIABLE, python_with_lerobot
from gym_open.errors import MissingExtraError, UsageError


def outcome(report: VerificationReport) -> str:
    return next(check.outcome for check in report.checks if check.name == "readers")


def test_without_lerobot_that_is_told_and_no_problem(release: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setitem(sys.modules, "lerobot", None)
    report = verify_release(release, replay=False)
    assert report.good
    assert outcome(report) == "pandas reads the same frames; LeRobot is not installed, so it did not read them"


def test_a_python_that_cannot_read_is_told(release: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "none"))
    assert python_with_lerobot() == str(tmp_path / "none")
    with pytest.raises(UsageError, match=f"{VARIABLE}: .*none: cannot be run .*; name a Python"):
        verify_release(release, replay=False)
    monkeypatch.setenv(VARIABLE, "false")
    assert "LeRobot cannot load it: it said nothing" in verify_release(release, replay=False).verdict


def test_what_is_not_installed_is_no_problem_of_the_release(release: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(MissingExtraError, match=r"not installed: pip install 'gym-open\[releases\]'"):
        verify_release(release, replay=False)
