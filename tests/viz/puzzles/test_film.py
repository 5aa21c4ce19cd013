"""Films of puzzles: agents side by side at the same pace, each image as the simulator draws it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open.envs.puzzles.sets import puzzle_by_id
from gym_open.envs.tasks import rewarded
from gym_open.envs.world import World
from gym_open.errors import UsageError
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.export import write_video
from gym_open.viz.film import enlarged
from gym_open.viz.puzzles.episodes import play_all
from gym_open.viz.puzzles.film import film, frames_a_step

MakeLog = Callable[..., Path]
PLAIN = VizConfig(film_look="observation")


def test_a_puzzle_is_filmed_side_by_side_at_one_pace(scores: Any) -> None:
    played = play_all("avoidance/000", [scores.path])
    each, steps = frames_a_step(played), len(scores.actions[0])
    assert each == 5
    frames, fps = film(played, "observation")
    found = list(frames)
    held = round(0.8 * fps)
    assert len(found) == 3 * held + steps * each
    world = World()
    world.load(puzzle_by_id("avoidance/000"), recolour_hits=rewarded("avoidance"))
    size, shown = 420, [found[0]]
    shown += [found[held - 1 + each * step] for step in range(1, steps + 1)]
    for frame, action in zip(shown, [None, *scores.actions[0]], strict=True):
        if action is not None:
            world.step(action)
        picture = enlarged(world.observe(), size)
        top = next(top for top in range(60) if np.array_equal(frame[top : top + size, :size], picture))
        np.testing.assert_array_equal(frame[top : top + size, size : 2 * size], picture)  # the witness did the same


def test_long_episodes_have_fewer_pictures_a_step(scores: Any) -> None:
    played = play_all("avoidance/001", [scores.path])
    assert 5 * sum(episode.steps for episode in played.episodes) < 600
    assert frames_a_step(played) == 5
    assert frames_a_step(msgspec.structs.replace(played, episodes=played.episodes * 2)) == 2
    assert frames_a_step(msgspec.structs.replace(played, episodes=played.episodes * 5)) == 1


def test_what_cannot_be_filmed_is_refused(scores: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ends in \.mp4 or \.gif, got '\.avi'"):
        write_video(PLAIN, [scores.path], Choice(), tmp_path / "play.avi")
    with pytest.raises(UsageError, match="cannot film scores; give one log or release, or scores and policies"):
        write_video(PLAIN, [scores.path], Choice(), tmp_path / "play.mp4")
    with pytest.raises(UsageError, match="--steps does not apply to a puzzle"):
        write_video(PLAIN, [scores.path], Choice(puzzle="avoidance/000", steps=range(3)), tmp_path / "play.mp4")
    assert not list(tmp_path.iterdir())
