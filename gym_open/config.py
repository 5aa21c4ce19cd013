"""Strict, frozen configuration: one type per stage, read from TOML and changed by command-line options.

An unknown key, or a value of the wrong type or out of bounds, is refused before any work starts; the error names it.
"""

import difflib
import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta

from gym_open.errors import ConfigError

PositiveInt = Annotated[int, Meta(ge=1)]
Count = Annotated[int, Meta(ge=0)]
PositiveFloat = Annotated[float, Meta(gt=0, le=sys.float_info.max)]
NonNegativeFloat = Annotated[float, Meta(ge=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]


_WORDS: dict[str, str] = {}


def matching(pattern: str, words: str) -> Meta:
    """Constraint on a text: the pattern that it must match, and the words that describe the pattern in an error."""
    _WORDS[pattern] = words
    return Meta(pattern=pattern)


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of every stage's configuration."""


C = TypeVar("C", bound=Config)

_UNKNOWN = re.compile(r"unknown field `(?P<key>[^`]*)`")
_PATH = re.compile(r" - at `\$(?P<path>[^`]*)`")


def load(path: Path, kind: type[C]) -> C:
    """Read a configuration of type `kind` from the TOML file at `path`.

    Raises:
        ConfigError: if the file cannot be read, is not TOML, or holds a key or value that `kind` does not allow.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(
            f"{path}: no such configuration file; give an existing one (`gym-open init` makes the default ones)"
        ) from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error}); give a TOML file") from None
    except RecursionError:
        raise ConfigError(f"{path}: nested too deeply; remove brackets") from None
    except ValueError as error:  # also of bytes that are no text, and of numbers with thousands of digits
        raise ConfigError(f"{path}: not valid TOML: {str(error)[:300]}") from None
    return decode(raw, kind, source=str(path))


def decode(raw: dict[str, Any], kind: type[C], *, source: str) -> C:
    """Turn plain data into a configuration of type `kind`; `source` is named in errors.

    Raises:
        ConfigError: if the data does not fit; names the source, the key, the expected value and the found value.
    """
    try:
        return msgspec.convert(raw, kind, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{source}: {_explain(str(error), raw, kind)}") from None


def check(config: C, *, source: str) -> C:
    """Check a configuration that was built in Python or from options: constructors check neither types nor bounds."""
    return decode(to_dict(config), type(config), source=source)


def to_dict(config: Config) -> dict[str, Any]:
    """The whole configuration, with its defaults, as plain data that JSON can hold."""
    return msgspec.to_builtins(config)


def to_toml(config: Mapping[str, Any]) -> str:
    """Plain data as TOML. TOML has no null, so a key whose value is None is left out, which means its default."""
    import tomli_w  # comes with the extra `releases`

    return tomli_w.dumps(_without_none(config))


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value if item is not None] if isinstance(value, list) else value


def _explain(message: str, raw: dict[str, Any], kind: type[Config]) -> str:
    place = _PATH.search(message)
    keys = re.findall(r"[^.\[\]]+", place["path"]) if place else []
    text = _PATH.sub("", message)
    if unknown := _UNKNOWN.search(text):
        key = unknown["key"]
        known = _fields_at(kind, keys)
        close = difflib.get_close_matches(key, known, n=1)
        hint = f"did you mean `{close[0]}`?" if close else f"known keys are {', '.join(known)}"
        return f"unknown key `{'.'.join([*keys, key])}`; {hint}"
    for pattern, words in _WORDS.items():
        text = text.replace(f"`str` matching regex {pattern!r}", words)
    if not keys:  # a check of the whole configuration: its message names the fields
        return text
    value: Any = raw
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else _item(value, key)
    return f"key `{'.'.join(keys)}`: {text[0].lower()}{text[1:]}, got {value!r}"


def _item(value: Any, key: str) -> Any:
    listed = isinstance(value, list | tuple) and key.isdecimal() and int(key) < len(value)
    return value[int(key)] if listed else None


def _fields_at(kind: type[Config], keys: list[str]) -> list[str]:
    inner: Any = kind
    for key in keys:
        inner = get_args(inner)[0] if key.isdecimal() and get_args(inner) else get_type_hints(inner).get(key)
        if get_origin(inner) is tuple or (isinstance(inner, type) and issubclass(inner, Config)):
            continue
        return []
    return list(inner.__struct_fields__)
