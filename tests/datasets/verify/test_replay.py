"""What the replay alone can find: releases that are changed as they are read, and played again."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open.datasets.verify.replaying import ReplayResult, replay_release
from gym_open.datasets.verify.report import Findings
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.reader import Release
from tests.children import is_alive, started, until

ASK = """
import os, sys
from pathlib import Path
from gym_open.datasets.verify.apart import replay_apart
from gym_open.datasets.verify.report import Findings
from gym_open.formats.releases import open_release
release = open_release(Path(sys.argv[1]))
os.environ["PYTHONPATH"] = sys.argv[2]
replay_apart(release, 1e-3, Findings())
"""
Numbers = Callable[[int, int], dict[str, np.ndarray]]


def replayed(release: Release) -> tuple[ReplayResult, list[str]]:
    findings = Findings()
    return replay_release(release, 1e-3, findings), [problem.what for problem in findings.problems]


@pytest.fixture
def release(root: Path) -> Release:
    return Release(root, "", read_info(root))


def change_keyframes(release: Release, change: Callable[[Any], Any]) -> None:
    original: Any = release.table
    table = change(original("keyframes").copy())
    release.table = lambda name: table if name == "keyframes" else original(name)


def shift_time(release: Release, row: int, by: float) -> None:
    """Nothing that is seen depends on the time in a stored state."""

    def change(table: Any) -> Any:
        state = table.loc[row, "integration_state"].copy()
        state[0] += by
        table.at[row, "integration_state"] = state
        return table

    change_keyframes(release, change)


def change_number(release: Release, name: str, frame: int, by: float) -> None:
    original: Numbers = release.numbers

    def numbers(first: int, stop: int) -> dict[str, np.ndarray]:
        values = {key: array.copy() for key, array in original(first, stop).items()}
        if first <= frame < stop:
            values[name][frame - first] += by
        return values

    release.numbers = numbers


@pytest.mark.parametrize(("by", "verdict"), [(1e-6, "within tolerance"), (1.0, "diverged")])
def test_a_stored_state_is_held_against_the_one_that_play_arrives_in(by: float, verdict: str, release: Release) -> None:
    """The window that ends in it is off, and so is the next, which begins in it."""
    shift_time(release, 1, by)
    replay, problems = replayed(release)
    assert [window.verdict for window in replay.windows] == [verdict] * 2 + ["identical"] * 4
    assert len(problems) == 2 * (verdict == "diverged")


@pytest.mark.parametrize("name", ["contact.count", "contact.agent"])
def test_another_number_of_contacts_has_diverged(name: str, release: Release) -> None:
    """Whatever the sum of the impulses, which is as it was."""
    change_number(release, name, 3, 1)
    _, problems = replayed(release)
    assert [("at step 4" in what, "contacts off in 1 step" in what) for what in problems] == [(True, True)]


def test_where_play_goes_on_the_first_frame_of_the_next_piece_is_compared(release: Release) -> None:
    change_keyframes(release, lambda table: table.drop(1))
    first = int(release.episodes["dataset_from_index"].iloc[1])
    assert replayed(release)[0].outcome == "identical (48 steps in 5 windows)"
    change_number(release, "observation.environment_state", first, 0.5)
    _, problems = replayed(release)
    assert ["off by 0.5" in what for what in problems] == [True]


def test_play_does_not_go_on_after_an_episode_that_ended(release: Release) -> None:
    change_keyframes(release, lambda table: table.drop(1))
    episodes = release.episodes.copy()
    episodes.loc[0, "ended"] = "interval"
    release.episodes = episodes
    replay, problems = replayed(release)
    assert (problems, replay.steps, replay.skipped) == ([], 40, 8)
    assert "8 not replayed" in replay.outcome


def test_nothing_replayed_is_not_verified(release: Release) -> None:
    change_keyframes(release, lambda table: table.iloc[:0])
    replay, problems = replayed(release)
    assert (replay.windows, replay.skipped) == ([], 48)
    assert ["none of 48 steps has a stored state before it" in what for what in problems] == [True]


def test_a_replay_of_its_own_process_ends_with_whoever_asked_for_it(root: Path, tmp_path: Path) -> None:
    """It is held up where it imports MuJoCo."""
    said = tmp_path / "pid"
    code = f"import os, signal; open({str(said)!r}, 'w').write(str(os.getpid())); signal.pause()"
    (tmp_path / "mujoco.py").write_text(code)
    with started([sys.executable, "-c", ASK, root, tmp_path]) as asked:
        pid = int(until(lambda: said.is_file() and said.read_text(), asked))
        asked.kill()
        until(lambda: not is_alive(pid))
