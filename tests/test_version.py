"""The version, which two files hold."""

import tomllib
from pathlib import Path

from gym_open.version import __version__


def test_pyproject_holds_the_same_version() -> None:
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["project"]["version"] == __version__
