"""The recording of a puzzle, read back: entities, timelines and values are those of the episodes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open.envs import constants as c
from gym_open.formats.pngs import decode_png
from gym_open.viz import viewers
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.puzzles import view
from gym_open.viz.puzzles.episodes import PlayedPuzzle, play_all

SOLVED = "avoidance/000"


@pytest.fixture(scope="module")
def played(scores: Any, policy: Path, others: Any) -> PlayedPuzzle:
    return play_all(SOLVED, [scores.path, policy, others.path])


@pytest.fixture(scope="module")
def recording(
    scores: Any, policy: Path, others: Any, tmp_path_factory: pytest.TempPathFactory, read_back: Callable[[Path], Any]
) -> Any:
    found = view(VizConfig(), [scores.path, policy, others.path], Choice(puzzle=SOLVED))
    assert found.title == SOLVED
    return read_back(viewers.save(found, tmp_path_factory.mktemp("view") / "puzzle.rrd"))


def test_every_agent_has_its_table_on_common_timelines(played: PlayedPuzzle, recording: Any) -> None:
    assert {"step", "sim_time"} <= recording.timelines()
    assert [episode.name for episode in played.episodes] == ["small", "other", "witness"]
    for number, episode in enumerate(played.episodes):
        assert {f"/{number}/observation", f"/{number}/table/agent", f"/{number}/return"} <= recording.entities()
        assert (f"/{number}/policy/value" in recording.entities()) == (number == 0)
        steps, centres = recording.column(f"/{number}/table/agent", "Ellipsoids3D:centers")
        agent = episode.states[:, episode.objects.index("agent"), :3]
        assert steps == list(range(episode.steps + 1))
        np.testing.assert_allclose(np.array(centres)[:, 0], agent, atol=1e-6)
        steps, blobs = recording.column(f"/{number}/observation", "EncodedImage:blob")
        pictures = [decode_png(bytes(blob[0])) for blob in blobs]
        np.testing.assert_array_equal(pictures, episode.images)


def test_returns_go_on_to_the_end_of_the_longest(played: PlayedPuzzle, recording: Any) -> None:
    for number, episode in enumerate(played.episodes):
        found = recording.scalars(f"/{number}/return")
        expected = dict(enumerate(np.concatenate([[0.0], np.cumsum(episode.rewards)]).tolist()))
        assert found == expected | {100: expected[episode.steps]}
        assert recording.scalars(f"/{number}/action") == dict(enumerate(episode.actions))
    assert recording.scalars("/2/return")[100] == 1.0
    assert recording.scalars("/1/return")[100] == 0.0


def test_touches_and_ends_are_told_and_seen(played: PlayedPuzzle, recording: Any) -> None:
    end = played.episodes[0].steps
    assert recording.column("/events/0", "TextLog:text") == (
        [end],
        [[f"small: touches yellow_0, return 1: solved in {end} actions"]],
    )
    assert recording.column("/events/1", "TextLog:text") == ([100], [["other: not solved in 100 actions"]])
    assert [recording.column(f"/events/{n}", "TextLog:level")[1] for n in range(2)] == [[["INFO"]], [["WARN"]]]
    steps, colours = recording.column("/0/table/yellow", "Ellipsoids3D:colors")
    rgb = [((value[0] >> 24) & 255, (value[0] >> 16) & 255, (value[0] >> 8) & 255) for value in colours]
    assert list(zip(steps, rgb, strict=True)) == [(0, c.COLOUR["yellow"]), (end, c.HIT_COLOUR["yellow"])]


def test_what_the_policy_would_do(played: PlayedPuzzle, recording: Any) -> None:
    own = played.episodes[0]
    assert own.policy is not None
    np.testing.assert_allclose(list(recording.scalars("/0/policy/entropy").values()), own.policy.entropy)
    steps, bars = recording.column("/0/policy/probabilities", "BarChart:values")
    assert steps == list(range(own.steps))
    values = np.array([bar[0]["buffer"] for bar in bars])
    np.testing.assert_allclose(values, own.policy.probabilities)
    _, arrows = recording.column("/0/table/policy", "Arrows3D:vectors")
    moves = np.array(c.MOVES[1:])
    diagonal = np.linalg.norm(moves, axis=1)
    np.testing.assert_allclose(
        np.linalg.norm(np.array(arrows), axis=2), 0.3 * own.policy.probabilities[:, 1:] * diagonal, atol=1e-6
    )


def test_the_document_names_agents_and_outcomes(recording: Any) -> None:
    text = recording.static("/about/puzzle", "TextDocument:text")[0]
    assert text.startswith("# avoidance/000")
    assert "| other | not solved in 100 actions | 0 |" in text
