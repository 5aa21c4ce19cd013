"""Check that the tables of a release agree with its episodes and with each other."""

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gym_open.datasets.verify.report import Findings, rows_of
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.puzzles.sets import reserved_digests
from gym_open.errors import GymOpenError
from gym_open.formats.releases.frames import LENGTH_CAP
from gym_open.formats.releases.layout import BOOKKEEPING
from gym_open.formats.releases.reader import Release

if TYPE_CHECKING:
    import pandas as pd

STREAMS, WORLDS, SWITCHES = "meta/streams", "meta/worlds", "meta/switches"
SEGMENTS, KEYFRAMES, CONTENT = "meta/segments", "meta/keyframes", "meta/content"
_SHOWN = 3


def check_tables(release: Release, findings: Findings) -> None:
    """Check all six tables."""
    _check_streams(release, findings)
    _check_worlds(release, findings)
    _check_switches(release, findings)
    _check_segments(release, findings)
    _check_keyframes(release, findings)
    _check_content(release, findings)


def puzzles_of(release: Release) -> dict[tuple[int, int], Puzzle]:
    """The puzzle of every stream and world.

    Raises:
        GymOpenError: if one of them is no puzzle.
    """
    worlds = release.table("worlds")
    places = zip(worlds["stream"].tolist(), worlds["world"].tolist(), worlds["json"].tolist(), strict=True)
    return {(stream, world): Puzzle.from_json(text) for stream, world, text in places}


def _tell(findings: Findings, file: str, rows: "pd.DataFrame", keys: list[str], what: str) -> None:
    """Record wrong rows of a table."""
    for row in rows_of(rows[keys].head(_SHOWN)):
        findings.add(file, f"{', '.join(f'{key} {value}' for key, value in row.items())}: {what}")


def _check_streams(release: Release, findings: Findings) -> None:
    streams, episodes = release.table("streams"), release.episodes
    numbers = streams["stream"].to_numpy()
    findings.expect(len(set(numbers.tolist())) == len(numbers), STREAMS, "a stream occurs twice")
    for row in rows_of(streams):
        try:
            msgspec.json.decode(row["config"], type=dict[str, Any])
        except (msgspec.DecodeError, RecursionError):
            findings.add(STREAMS, f"stream {row['stream']}: its configuration is not JSON")
    joined = episodes.merge(streams[["stream", "explorer", "steps"]], on="stream", how="left", suffixes=("", "_all"))
    _tell(findings, STREAMS, joined[joined["steps_all"].isna()], ["stream", "episode_index"], "no such stream")
    there = joined[joined["steps_all"].notna()]
    wrong = (there["explorer"] != there["explorer_all"]) | (there["first_step"] + there["steps"] > there["steps_all"])
    _tell(findings, STREAMS, there[wrong], ["stream", "episode_index"], "has another explorer, or more steps")


def _check_worlds(release: Release, findings: Findings) -> None:
    worlds, episodes = release.table("worlds"), release.episodes
    findings.expect(not worlds.duplicated(["stream", "world"]).any(), WORLDS, "a world occurs twice")
    reserved = reserved_digests()
    for row in rows_of(worlds):
        where = f"stream {row['stream']}, world {row['world']}"
        try:
            puzzle = Puzzle.from_json(row["json"])
        except (GymOpenError, RecursionError) as error:
            findings.add(WORLDS, f"{where}: {error}"[:300])
            continue
        findings.expect(puzzle.to_json().decode() == row["json"], WORLDS, f"{where}: its JSON is not in canonical form")
        findings.expect(
            puzzle.digest == row["puzzle"], WORLDS, f"{where}: its JSON is not that of the layout {row['puzzle']}"
        )
        findings.expect(puzzle.task == "sandbox", WORLDS, f"{where}: a puzzle of a task, not the sandbox")
        findings.expect(puzzle.digest not in reserved, WORLDS, f"{where}: it is the layout of an evaluation puzzle")
    keys = ["stream", "world"]
    joined = episodes.merge(worlds, on=keys, how="left", suffixes=("", "_of_world"), indicator="found")
    missing = joined["found"] != "both"
    _tell(findings, WORLDS, joined[missing], [*keys, "episode_index"], "no such world")
    wrong = ~missing & ((joined["puzzle"] != joined["puzzle_of_world"]) | (joined["split"] != joined["split_of_world"]))
    _tell(findings, WORLDS, joined[wrong], [*keys, "episode_index"], "has another layout or split than its world")


def _check_switches(release: Release, findings: Findings) -> None:
    """Check that segments begin and end at switches."""
    switches = release.table("switches")
    episodes = release.episodes
    steps = release.table("streams").set_index("stream")["steps"].to_dict()
    late = switches["step"] > switches["stream"].map(steps).fillna(-1)
    _tell(findings, SWITCHES, switches[late | (switches["step"] < 0)], ["stream", "step"], "no step of such a stream")
    worlds = set(zip(*(release.table("worlds")[key].tolist() for key in ("stream", "world")), strict=True))
    for key in ("from_world", "to_world"):
        known = [place in worlds or place[1] == -1 for place in zip(switches["stream"], switches[key], strict=True)]
        _tell(findings, SWITCHES, switches[~np.array(known, bool)], ["stream", "step", key], "no such world")
    entered = set(zip(switches["stream"], switches["step"], switches["to_world"], strict=True))
    left = set(zip(switches["stream"], switches["step"], switches["from_world"], switches["reason"], strict=True))
    for row in rows_of(episodes[(episodes["piece"] == 0) | (episodes["ended"] != LENGTH_CAP)]):
        where, end = f"stream {row['stream']}, segment {row['segment']}", row["first_step"] + row["steps"]
        if row["piece"] == 0 and (row["stream"], row["first_step"], row["world"]) not in entered:
            findings.add(SWITCHES, f"{where}: no switch leads to world {row['world']} at step {row['first_step']}")
        if row["ended"] != LENGTH_CAP and (row["stream"], end, row["world"], row["ended"]) not in left:
            findings.add(SWITCHES, f"{where}: no switch leaves world {row['world']} at step {end} ({row['ended']})")


def _check_segments(release: Release, findings: Findings) -> None:
    """Check that each segment follows from its episodes, which may be a selection."""
    keys = ["stream", "segment"]
    found = release.table("segments")
    findings.expect(not found.duplicated(keys).any(), SEGMENTS, "a segment occurs twice")
    groups = release.episodes.sort_values([*keys, "piece"]).groupby(keys)
    expected = groups.first()[["world", "puzzle", "first_step", "continued"]].assign(
        steps=groups["steps"].sum(), ended=groups["ended"].last()
    )
    joined = expected.reset_index().merge(found, on=keys, how="outer", suffixes=("", "_found"), indicator="there")
    both = joined["there"] == "both"
    _tell(findings, SEGMENTS, joined[~both], keys, "is missing, or has no episode")
    names = ("world", "puzzle", "first_step", "continued", "steps", "ended")
    same = np.all([joined[name] == joined[f"{name}_found"] for name in names], axis=0)
    _tell(findings, SEGMENTS, joined[both & ~same], keys, "does not follow from its episodes")


def _check_keyframes(release: Release, findings: Findings) -> None:
    frames, episodes = release.table("keyframes"), release.episodes.set_index("episode_index")
    known = frames["episode_index"].isin(episodes.index)
    _tell(findings, KEYFRAMES, frames[~known], ["stream", "segment", "episode_index"], "no such episode")
    frames = frames[known]
    rows = episodes.loc[frames["episode_index"]].reset_index()
    findings.expect(not frames.duplicated(["episode_index", "frame_index"]).any(), KEYFRAMES, "a keyframe occurs twice")
    before = frames["segment_step"].to_numpy() - frames["frame_index"].to_numpy()  # segment steps before it
    begins = rows["first_step"] - before  # the same for all of a segment
    good = (
        (frames["stream"].to_numpy() == rows["stream"].to_numpy())
        & (frames["segment"].to_numpy() == rows["segment"].to_numpy())
        & (frames["frame_index"].to_numpy() >= 0)
        & (frames["frame_index"].to_numpy() < rows["length"].to_numpy())
        & ((rows["piece"].to_numpy() > 0) | (before == 0))
        & (begins == begins.groupby([rows["stream"], rows["segment"]]).transform("first")).to_numpy()
    )
    _tell(findings, KEYFRAMES, frames[~good], ["episode_index", "frame_index"], "does not fit that episode and frame")
    begun = frames.loc[frames["frame_index"] == 0, "episode_index"]
    lacking = release.episodes[(release.episodes["piece"] == 0) & ~release.episodes["episode_index"].isin(begun)]
    _tell(findings, KEYFRAMES, lacking, ["episode_index"], "begins a segment, but its first frame has no stored state")
    _check_distances(release, findings)
    finite = frames["integration_state"].map(lambda state: bool(np.isfinite(state).all()))
    _tell(findings, KEYFRAMES, frames[~finite.astype(bool)], ["episode_index", "frame_index"], "is not finite")


def _check_distances(release: Release, findings: Findings) -> None:
    """Check that keyframes in consecutive pieces of a segment are as close as the stream's configuration says.

    A log has a keyframe at the start of a segment and after a fixed number of steps. Selected episodes may begin
    anywhere in between.
    """
    streams = release.table("streams")
    distances = dict(zip(streams["stream"], map(_keyframe_distance, streams["config"]), strict=True))
    rows = release.episodes.sort_values(["stream", "segment", "piece"])
    frames = release.table("keyframes")
    states = dict(list(frames.groupby("episode_index")["frame_index"]))
    last: dict[str, Any] = {}
    since = 0
    """Steps since the last keyframe; before the first one, steps since the first piece, plus one."""
    for row in rows_of(rows):
        most = distances.get(row["stream"])
        if not last or any(row[key] != last[key] + (key == "piece") for key in ("stream", "segment", "piece")):
            since = 1
        last, at, gaps = row, 0, []
        for frame in sorted(states.get(row["episode_index"], ())):
            gaps.append(since + frame - at)
            since, at = 0, frame
        since += row["steps"] - at
        if most is not None and max(*gaps, since, 0) > most:
            what = f"episode {row['episode_index']}: more than {most} steps without a state"
            findings.add(KEYFRAMES, f"{what}, the largest distance in its stream's configuration")


def _keyframe_distance(config: str) -> int | None:
    """Number of steps between keyframes in a log with this configuration, if the configuration gives it."""
    try:
        said = msgspec.json.decode(config, type=dict[str, Any]).get("log")
    except (msgspec.DecodeError, RecursionError):
        return None
    distance = said.get("keyframe_every") if isinstance(said, dict) else None
    return distance if isinstance(distance, int) else None


def _check_content(release: Release, findings: Findings) -> None:
    content = release.table("content")
    findings.expect(
        content["episode_index"].tolist() == list(range(len(release.episodes))), CONTENT,
        "there is not one row per episode, in their order",
    )  # fmt: skip
    for name in release.info["features"]:
        if name not in BOOKKEEPING:
            findings.expect(
                bool(content[name].str.fullmatch(r"[0-9a-f]{64}").all()), CONTENT, f"column {name}: not SHA-256"
            )
