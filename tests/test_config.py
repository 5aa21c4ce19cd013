"""Configuration: strict by name, type and bounds."""

from pathlib import Path

import pytest

from gym_open.collect.config import CollectConfig
from gym_open.config import Config, PositiveFloat, PositiveInt, check, decode, load, to_dict
from gym_open.errors import ConfigError


class Inner(Config, frozen=True, kw_only=True):
    rate: float = 0.5
    scale: PositiveFloat = 1.0


class Outer(Config, frozen=True, kw_only=True):
    budget: PositiveInt = 10
    name: str = "x"
    inner: Inner = Inner()


def _write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "c.toml"
    path.write_text(text)
    return path


def test_values_come_from_the_file_and_defaults_from_the_type(tmp_path: Path) -> None:
    config = load(_write(tmp_path, "budget = 7\n[inner]\nrate = 1\n"), Outer)
    assert config == Outer(budget=7, inner=Inner(rate=1.0))
    assert to_dict(config) == {"budget": 7, "name": "x", "inner": {"rate": 1.0, "scale": 1.0}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("budgt = 7", ["c.toml", "unknown key `budgt`", "did you mean `budget`?"]),
        ("zebra = 7", ["unknown key `zebra`", "known keys are budget, name, inner"]),
        ("[inner]\nrat = 1.0", ["unknown key `inner.rat`", "did you mean `rate`?"]),
        ('budget = "many"', ["key `budget`", "expected `int`", "got 'many'"]),
        ("budget = -3", ["key `budget`", ">= 1", "got -3"]),
        ("budget = 1.5", ["key `budget`", "got 1.5"]),
        ('[inner]\nrate = "fast"', ["key `inner.rate`", "got 'fast'"]),
        ("[inner]\nscale = 0.0", ["key `inner.scale`", "got 0.0"]),
        ("[inner]\nscale = inf", ["key `inner.scale`", "got inf"]),
        ("[inner]\nscale = nan", ["key `inner.scale`", "got nan"]),
        ("budget = = 2", ["not valid TOML"]),
    ],
)
def test_a_wrong_key_or_value_is_named(tmp_path: Path, text: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        load(_write(tmp_path, text), Outer)
    for word in words:
        assert word in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: no such configuration") as caught:
        load(tmp_path / "nowhere.toml", Outer)
    assert "--config" not in str(caught.value)  # some commands have no file of their own name
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path, Outer)


def test_bounds_hold_for_values_from_options_too() -> None:
    with pytest.raises(ConfigError, match="options: key `budget`"):
        check(Outer(budget=-1), source="options")
    assert check(Outer(budget=1), source="options") == Outer(budget=1)


def test_decode_is_the_inverse_of_to_dict() -> None:
    config = Outer(budget=3, inner=Inner(rate=0.1))
    assert decode(to_dict(config), Outer, source="x") == config


def test_the_form_of_a_text_is_described_in_words() -> None:
    from gym_open.datasets.config import ReleaseConfig

    with pytest.raises(ConfigError, match=r"key `version`: expected three numbers, as 1\.0\.0, got '1\.0'"):
        decode({"version": "1.0"}, ReleaseConfig, source="file")


HOSTILE = ("seed = " + "[" * 20_000 + "]" * 20_000, "seed = " + "9" * 5_000, "seed = \x00", "a." * 5_000 + "b = 1")


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_toml_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"c\.toml"):
        load(tmp_path / "c.toml", CollectConfig)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load(tmp_path / "c.toml", CollectConfig)
