"""Find what changed in the episodes of a release, from the digests of their features."""

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from gym_open.datasets.compare.versions import Meaning
from gym_open.errors import ArtefactError
from gym_open.formats.releases import Release
from gym_open.formats.releases.content import EPISODE_FACTS, EPISODE_PLACES

if TYPE_CHECKING:
    import pandas as pd

_FACTS = [name for name in EPISODE_FACTS if name != "split"]
"""Facts whose change is a change of the episode. A move to another split is reported separately."""
_PLACE = [name for name in EPISODE_PLACES if name != "first_step"]
"""Two episodes with the same values here are the same episode, even if its content changed."""
_SHOWN = 8
"""Largest number of episode numbers in a sentence."""


def episode_meanings(old: Release, new: Release, features: Sequence[str]) -> Iterator[Meaning]:
    """Find the changes of the episodes, by `features` that both releases have in the same form.

    Raises:
        ArtefactError: if a release's tables `episodes` and `content` do not fit together.
    """
    a, b = _episodes(old, features), _episodes(new, features)
    identity = [*features, *_FACTS]
    if len(b) >= len(a) and a.equals(b.iloc[: len(a)]):
        if len(b) > len(a):
            yield Meaning("minor", f"{_count(len(b) - len(a))} appended ({_numbers(range(len(a), len(b)))})")
        return
    pairs = _pairs(_keys(a, identity), _keys(b, identity))
    yield from _moved(a, b, pairs)
    yield from _unmatched(a, b, pairs, identity)


def _episodes(release: Release, features: Sequence[str]) -> "pd.DataFrame":
    """One row per episode, in order: facts, place, digests of the features."""
    import pandas as pd

    content, episodes = release.table("content"), release.episodes
    numbers = list(range(len(episodes)))
    if content["episode_index"].tolist() != numbers or episodes["episode_index"].tolist() != numbers:
        raise ArtefactError(
            f"{release.root}/meta/content: its episode_index is not 0 to {len(episodes) - 1} in order, as "
            "meta/episodes has it; build the release again"
        )
    facts = episodes[[*EPISODE_FACTS, *EPISODE_PLACES]].reset_index(drop=True)
    return pd.concat([facts, content[list(features)].reset_index(drop=True)], axis=1)


def _keys(table: "pd.DataFrame", columns: Sequence[str]) -> list[tuple[Any, ...]]:
    return list(table[list(columns)].itertuples(index=False, name=None))


def _pairs(a: list[tuple[Any, ...]], b: list[tuple[Any, ...]]) -> list[tuple[int, int]]:
    """Numbers (old, new) of episodes with equal keys. Several equal episodes are paired in order."""
    places: dict[tuple[Any, ...], list[int]] = {}
    for number, key in enumerate(b):
        places.setdefault(key, []).append(number)
    waiting = {key: iter(numbers) for key, numbers in places.items()}
    found = ((number, next(waiting[key], None)) for number, key in enumerate(a) if key in waiting)
    return [(number, other) for number, other in found if other is not None]


def _moved(a: "pd.DataFrame", b: "pd.DataFrame", pairs: list[tuple[int, int]]) -> Iterator[Meaning]:
    """Changes of unchanged episodes: another order, split or place in the exploration."""
    for name in ("split", *EPISODE_PLACES):
        elsewhere = [i for i, j in pairs if a[name].iloc[i] != b[name].iloc[j]]
        if elsewhere:
            yield Meaning("major", f"{_count(len(elsewhere))} moved to another {name} ({_numbers(elsewhere)})")
    if any(j > k for (_, j), (_, k) in itertools.pairwise(pairs)):
        yield Meaning("major", "episodes reordered")


def _unmatched(
    a: "pd.DataFrame", b: "pd.DataFrame", pairs: list[tuple[int, int]], identity: list[str]
) -> Iterator[Meaning]:
    """Other episodes: changed if both have the same place, else removed or added."""
    gone = sorted(set(range(len(a))) - {i for i, _ in pairs})
    come = sorted(set(range(len(b))) - {j for _, j in pairs})
    left, right = a.iloc[gone], b.iloc[come]
    changed = _pairs(_keys(left, _PLACE), _keys(right, _PLACE))
    if changed:
        differing = [
            name for name in (*identity, "split") if any(left[name].iloc[i] != right[name].iloc[j] for i, j in changed)
        ]
        numbers = [gone[i] for i, _ in changed]
        yield Meaning("major", f"{_count(len(changed))} changed ({_numbers(numbers)}): {', '.join(differing)}")
    removed = [number for i, number in enumerate(gone) if i not in {i for i, _ in changed}]
    added = [number for j, number in enumerate(come) if j not in {j for _, j in changed}]
    if removed:
        yield Meaning("major", f"{_count(len(removed))} removed ({_numbers(removed)})")
    last = max((j for _, j in pairs), default=-1)
    between = [number for number in added if number < last]
    if between:
        yield Meaning("major", f"{_count(len(between))} inserted before old ones ({_numbers(between)})")
    if after := [number for number in added if number > last]:
        yield Meaning("minor", f"{_count(len(after))} added after the old ones ({_numbers(after)})")


def _count(number: int) -> str:
    return f"{number:,} episode{'s' * (number != 1)}"


def _numbers(numbers: Sequence[int]) -> str:
    """Write the numbers of episodes as ranges: `3, 5–9`."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    shown = [f"{first}" if first == last else f"{first}–{last}" for first, last in runs[:_SHOWN]]
    return ", ".join([*shown, *["…"] * (len(runs) > _SHOWN)])
