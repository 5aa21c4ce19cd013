"""Play that was forged and then released: every byte and record fits, and the replay alone can tell."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open.datasets import build, documents
from gym_open.datasets.build import build_release
from gym_open.datasets.config import FilterConfig, ReleaseConfig
from gym_open.datasets.filter import filter_release
from gym_open.datasets.verify import VerificationReport, run, verify_release
from gym_open.datasets.writing.sources import SourceEpisode, episodes_of_logs
from gym_open.formats.releases import open_release

EVERY = 8
"""Steps between two keyframes."""


def made(
    log: Path, out: Path, *, cap: int = EVERY, forge: Callable[[SourceEpisode], SourceEpisode] = lambda one: one
) -> Path:
    """A release, all records of it of episodes that `forge` had in its hands first."""

    def forged(*given: Any) -> Iterator[SourceEpisode]:
        return (forge(episode) for episode in episodes_of_logs(*given))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "draw", lambda _: {})
        patch.setattr(build, "episodes_of_logs", forged)
        return build_release(ReleaseConfig(max_episode_steps=cap, val_fraction=0.5), [log], out).path


Verify = Callable[[Path], VerificationReport]


def outcome(report: VerificationReport, name: str) -> str:
    return next(check.outcome for check in report.checks if check.name == name)


def test_real_play_is_replayed_to_the_bit(root: Path, verify: Verify) -> None:
    report = verify(root)
    assert report.problems == []
    assert outcome(report, "replay") == "identical (48 steps in 6 windows)"
    assert "replay: identical (48 steps in 6 windows)" in report.verdict
    assert report.replayed


@pytest.mark.slow
def test_windows_go_on_in_the_next_piece_and_what_no_state_comes_before_is_counted(
    log: Path, tmp_path: Path, verify: Verify, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Segments of 24 steps, cut at 12, with states at 0, 8 and 16. A piece without the one before begins at 16."""
    monkeypatch.setattr(documents, "draw", lambda _: {})
    whole = made(log, tmp_path / "1.0.0", cap=12)
    report = verify(whole)
    assert (report.problems, outcome(report, "replay")) == ([], "identical (48 steps in 6 windows)")
    some = filter_release(FilterConfig(name="open/touched", min_contact=0.1), whole, tmp_path / "touched").path
    assert open_release(some).episodes["piece"].tolist().count(1) == 2
    report = verify(some)
    assert report.problems == []
    assert outcome(report, "replay").startswith("identical (32 steps in 4 windows, 4 not replayed")


def at(row: dict[str, Any], **values: Any) -> bool:
    return all(row[name] == value for name, value in values.items())


def first(change: Callable[[SourceEpisode], SourceEpisode]) -> Callable[[SourceEpisode], SourceEpisode]:
    """Forges the first episode of the first stream alone."""
    return lambda one: change(one) if at(one.row, stream=0, segment=0, piece=0) else one


def one_pixel(one: SourceEpisode) -> SourceEpisode:
    assert one.images is not None
    images = one.images.copy()
    images[5, 40, 40, 1] ^= 1
    return msgspec.structs.replace(one, images=images)


def one_action(one: SourceEpisode) -> SourceEpisode:
    numbers = {name: array.copy() for name, array in one.numbers.items()}
    action = (int(numbers["action.index"][2]) + 3) % 8 + 1
    numbers["action.index"][2] = action
    numbers["action"][2] = np.eye(9)[action]
    return msgspec.structs.replace(one, numbers=numbers)


def one_number(one: SourceEpisode) -> SourceEpisode:
    numbers = {name: array.copy() for name, array in one.numbers.items()}
    numbers["observation.environment_state"][3, 13] += np.float32(0.01)  # the second object, which is not the agent
    return msgspec.structs.replace(one, numbers=numbers)


def one_contact(one: SourceEpisode) -> SourceEpisode:
    numbers = {name: array.copy() for name, array in one.numbers.items()}
    numbers["contact.count"][4] += 1
    numbers["contact.impulse"][4] += 1
    return msgspec.structs.replace(one, numbers=numbers)


def one_state(one: SourceEpisode) -> SourceEpisode:
    """The stored state is a hair off in the place of the agent."""
    state = one.keyframes[0].integration_state.copy()
    state[1] += 1e-2
    return msgspec.structs.replace(one, keyframes=[one.keyframes[0]._replace(integration_state=state)])


@pytest.mark.parametrize(
    ("forge", "words"),
    [
        (one_action, "off by"),
        pytest.param(one_state, "off by", marks=pytest.mark.slow),
        pytest.param(one_number, "off by 0.01", marks=pytest.mark.slow),
        pytest.param(one_contact, "contacts off in 1 step", marks=pytest.mark.slow),
    ],
)
def test_what_was_not_played_is_found_by_the_replay_alone(
    forge: Callable[[SourceEpisode], SourceEpisode], words: str, log: Path, tmp_path: Path, verify: Verify
) -> None:
    report = verify(made(log, tmp_path / "1.0.0", forge=first(forge)))
    assert [check.name for check in report.checks if check.good is False] == ["replay"]
    assert "diverged" in outcome(report, "replay") or "problem" in outcome(report, "replay")
    (problem,) = report.problems
    assert problem.file.startswith("data/chunk-")
    assert words in problem.what


@pytest.mark.slow
def test_one_level_of_one_pixel_is_told(log: Path, tmp_path: Path, verify: Verify) -> None:
    """Within tolerance, as edges are on another processor, but not identical: the report has the pixel."""
    report = verify(made(log, tmp_path / "1.0.0", forge=first(one_pixel)))
    assert outcome(report, "replay") == "within tolerance (48 steps in 6 windows)"
    assert list(report.replayed[1].columns[-1].cells) == ["1"]


@pytest.mark.slow
def test_a_state_that_makes_the_simulation_end_is_a_problem_and_ends_nothing_else(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All objects in one heap, and asleep: MuJoCo calls exit."""

    def heap(one: SourceEpisode) -> SourceEpisode:
        state = one.keyframes[0].integration_state.copy()
        count = one.numbers["observation.environment_state"].shape[1] // 13
        poses = state[1 : 1 + 7 * count].reshape(count, 7)
        poses[:] = 0, 0, 0.05, 1, 0, 0, 0
        poses[:, :3] += np.random.default_rng(3).normal(size=(count, 3)) * 0.1
        return msgspec.structs.replace(one, keyframes=[one.keyframes[0]._replace(integration_state=state)])

    root = made(log, tmp_path / "1.0.0", forge=heap)
    monkeypatch.setattr(run, "check_lerobot", lambda *_: None)
    monkeypatch.chdir(tmp_path)
    (problem,) = verify_release(root).problems
    assert problem.file == "meta/keyframes"
    assert "the simulation ended, code 1: ERROR" in problem.what
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
