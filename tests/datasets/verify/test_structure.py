"""Tables that are well-formed each and do not fit together; frames that no explorer leaves. Nothing is written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open.datasets.verify.contents import wrong_in
from gym_open.datasets.verify.report import Findings, rows_of
from gym_open.datasets.verify.structure import check_episodes, check_info
from gym_open.datasets.verify.tables import check_tables
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.reader import Release

Change = Callable[[Release], None]


def opened(root: Path) -> Release:
    return Release(root, "", read_info(root))


def found(release: Release) -> list[str]:
    findings = Findings()
    check_episodes(release, findings)
    check_info(release, findings)
    check_tables(release, findings)
    return [problem.what for problem in findings.problems]


def in_table(which: str, column: str, change: Callable[[Any], Any], row: int = 0) -> Change:
    """One value of a table of ours is another."""

    def apply(release: Release) -> None:
        original: Any = release.table
        table = original(which).copy()
        table.loc[row, column] = change(table.loc[row, column])
        release.table = lambda name: table if name == which else original(name)

    return apply


def in_episodes(column: str, change: Callable[[Any], Any], row: int) -> Change:
    """One value of `meta/episodes` is another."""

    def apply(release: Release) -> None:
        episodes = release.episodes.copy()
        episodes.loc[row, column] = change(episodes.loc[row, column])
        release.episodes = episodes

    return apply


def without_keyframe(row: int) -> Change:
    def apply(release: Release) -> None:
        original: Any = release.table
        table = original("keyframes").drop(row).reset_index(drop=True)
        release.table = lambda name: table if name == "keyframes" else original(name)

    return apply


def in_info(name: str, change: Callable[[Any], Any]) -> Change:
    def apply(release: Release) -> None:
        release.info["gym_open"][name] = change(release.info["gym_open"][name])

    return apply


def pieces_shifted(release: Release) -> None:
    """As if each segment had begun before, where no state of its beginning is asked for."""
    release.episodes = release.episodes.assign(piece=release.episodes["piece"] + 1)


def test_tables_of_real_play_fit_together(root: Path) -> None:
    assert found(opened(root)) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (in_info("max_episode_steps", lambda _: 7), "has more steps than an episode may have"),
        (in_info("val", lambda _: []), "gym_open.val does not fit"),
        (in_episodes("continued", lambda _: False, 1), "episode 0 does not continue in the next piece"),
        (in_episodes("piece", lambda _: 7, 1), "overlaps the next piece"),
        (in_episodes("split", lambda split: "val" if split == "train" else "train", 1), "more than one split"),
        (pieces_shifted, "the piece before it is missing"),
        (in_table("switches", "step", lambda _: 999, 1), "step 999: no step of such a stream"),
        (in_table("keyframes", "segment_step", lambda step: step + 1, 1), "does not fit that episode and frame"),
        (in_table("streams", "config", lambda text: text.replace('every":8', 'every":7')), "more than 7 steps without"),
        (without_keyframe(1), "more than 8 steps without a state"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_tables_that_do_not_fit_together(change: Change, words: str, root: Path) -> None:
    release = opened(root)
    change(release)
    assert any(words in what for what in found(release)), found(release)


@pytest.mark.parametrize(
    ("name", "frame", "value", "words"),
    [
        ("policy.value", -1, 1, "policy.value is not 0 on the last frame"),
        ("contact.count", -1, 1, "contact.count is not 0 on the last frame"),
        ("world_model.loss", -1, 1, "world_model.loss is not 0 on the last frame"),
        ("reward_part.forward", -1, 0, "reward_part.forward is not NaN on the last frame"),
        ("policy.entropy", 0, np.nan, "policy.entropy is not finite"),
        ("policy.value", 1, np.inf, "policy.value is not finite"),
        ("reward.intrinsic", 2, np.nan, "reward.intrinsic is not finite"),
    ],
)
def test_frames_that_no_explorer_leaves(name: str, frame: int, value: float, words: str, made_up: Path) -> None:
    release = opened(made_up)
    row = rows_of(release.episodes)[0]
    values = {key: array.copy() for key, array in release.numbers(0, row["length"]).items()}
    values["observation.state"] = values["observation.environment_state"][:, :13]  # of the agent, which is the first
    before = list(wrong_in(values, row, release.info["features"]))
    values[name][frame] = value
    assert [what for what in wrong_in(values, row, release.info["features"]) if what not in before] == [words]
