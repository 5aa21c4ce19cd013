"""README.md: the card of a release, in the hub's form, written from the data alone, without dates or paths."""

from collections.abc import Iterator, Mapping
from typing import Any

from gym_open.datasets.config import Header
from gym_open.datasets.papers.card_text import BODY, FRONT, MEANINGS, SURPRISES, VIDEO
from gym_open.datasets.papers.facts import Facts, Range
from gym_open.datasets.papers.markdown import plain, table
from gym_open.formats.releases.features import ACTION_NAMES, fps
from gym_open.formats.releases.layout import PART

_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
"""The hub's categories, by frames."""
_LARGEST = "10M<n<100M"
_COLLECTED = ("pool", "rollout", "seed")


def description(facts: Facts) -> str:
    """A sentence or two on what the release is."""
    release = facts.release
    return (
        f"What exploration policies saw and did in gym-open's sandbox, a table with spheres and cubes that an agent "
        f"pushes about by nine discrete moves, without a task and without a reward from outside: {len(release):,} "
        f"frames of 84×84 RGB in {len(release.episodes):,} episodes, {facts.steps:,} actions at {fps()} a simulated "
        "second."
    )


def card(header: Header, facts: Facts) -> str:
    """Text of the card."""
    release, ours = facts.release, facts.release.info["gym_open"]
    front = FRONT.format(
        license=header.license,
        name=header.name,
        size=next((name for most, name in _SIZES if len(release) < most), _LARGEST),
        splits="\n".join(_split_files(facts)),
    )
    body = BODY.format(
        name=header.name,
        version=header.version,
        description=description(facts),
        glance=_glance(facts),
        splits=_splits(facts),
        split_by=ours["split_by"],
        collected=_collected(facts),
        played=_played(facts),
        actions=_actions(facts),
        ranges=_ranges(facts),
        features=_features(release.info["features"]),
    )
    surprises = SURPRISES.format(cap=f"{ours['max_episode_steps']:,}", split_by=ours["split_by"], pictures=_video(ours))
    return front + body + surprises


def _video(ours: Mapping[str, Any]) -> str:
    """How far pictures are from the logged ones, if they are video."""
    if "video_error" not in ours:
        return ""
    error = ours["video_error"]
    psnr = f", PSNR {error['psnr']:.1f} dB" if error["psnr"] is not None else ""
    return VIDEO.format(mean=error["mean"], max=error["max"], psnr=psnr)


def _split_files(facts: Facts) -> Iterator[str]:
    for name, split in facts.splits.items():
        if split.chunks:
            yield f"  - split: {name}\n    path:"
            yield from (f"    - data/chunk-{chunk:03d}/*.parquet" for chunk in split.chunks)


def _glance(facts: Facts) -> str:
    release = facts.release
    frames, steps = len(release), facts.steps
    rows = [
        ("frames", f"{frames:,}"),
        ("episodes", f"{len(release.episodes):,}"),
        ("actions", f"{steps:,}"),
        ("simulated time", f"{steps / fps() / 60:,.1f} minutes"),
        ("streams", f"{release.episodes['stream'].nunique():,}"),
        ("worlds (distinct layouts)", f"{release.episodes['puzzle'].nunique():,}"),
        ("explorers", ", ".join(plain(one.explorer) for one in facts.played)),
        ("size of the frames", f"{facts.data_bytes / 1e6:,.1f} MB, {facts.data_bytes / frames:,.0f} bytes a frame"),
        ("episodes ended by", ", ".join(f"{plain(reason)} {count:,}" for reason, count in sorted(facts.ended.items()))),
    ]
    return table(["", ""], rows)


def _splits(facts: Facts) -> str:
    rows = [
        (name, *(f"{value:,}" for value in (split.episodes, split.frames, split.steps, split.worlds)))
        for name, split in facts.splits.items()
    ]
    return table(["split", "episodes", "frames", "actions", "worlds"], rows, right=4)


def _collected(facts: Facts) -> str:
    """A row a log: who played, under which curriculum, for how long, from which seed."""
    rows = []
    for log in facts.logs:
        curriculum = log.config.get("curriculum")
        rule = curriculum.get("rule", "–") if isinstance(curriculum, Mapping) else "–"
        drawn = [plain(log.config.get(key, "–")) for key in _COLLECTED]
        rows.append((plain(log.explorer), plain(rule), f"{log.steps:,}", str(log.streams), *drawn))
    return table(["explorer", "curriculum", "steps", "streams", "pool of worlds", "rollout", "seed"], rows, right=5)


def _played(facts: Facts) -> str:
    rows = [
        (
            plain(one.explorer),
            *(f"{value:,}" for value in (one.episodes, one.frames, one.streams, one.worlds)),
            f"{one.touching / max(one.steps, 1):.1%}",
            f"{(one.visits > 0).mean():.0%}",
        )
        for one in facts.played
    ]
    head = ["explorer", "episodes", "frames", "streams", "worlds", "steps touching something", "of the table seen"]
    return table(head, rows, right=6)


def _actions(facts: Facts) -> str:
    rows = [
        (plain(one.explorer), *(f"{count / max(one.steps, 1):.1%}" for count in one.actions)) for one in facts.played
    ]
    return table(["explorer", *ACTION_NAMES], rows, right=len(ACTION_NAMES))


def _ranges(facts: Facts) -> str:
    """A row an explorer and feature of which there is a finite value."""
    rows = [
        (plain(one.explorer), f"`{_code(name)}`", *_range_cells(found))
        for one in facts.played
        for name, found in one.ranges.items()
        if found.finite
    ]
    return table(["explorer", "feature", "least", "median", "mean", "greatest", "finite"], rows, right=5)


def _range_cells(found: Range) -> Iterator[str]:
    for value in (found.low, found.median, found.mean, found.high):
        yield f"{value:.4g}"
    yield f"{found.finite:.0%}"


def _features(features: Mapping[str, Any]) -> str:
    rows = []
    for name, feature in features.items():
        meaning = MEANINGS["reward_part"] if name.startswith(PART) else MEANINGS.get(name, "")
        rows.append((f"`{_code(name)}`", feature["dtype"], "×".join(map(str, feature["shape"])), meaning))
    return table(["feature", "type", "shape", ""], rows)


def _code(name: str) -> str:
    """A feature's name between back-ticks, where nothing is escaped."""
    return "".join(c if c.isalnum() or c in "._-+ " else "?" for c in name)
