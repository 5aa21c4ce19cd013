"""A person at the keyboard: a press is a move, all moves are logged and scored, a closed window loses nothing."""

import functools
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pygame
import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.envs import constants as c
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles.sets import puzzle_by_id, puzzles_of
from gym_open.envs.world import World
from gym_open.errors import ArtefactError, ConfigError
from gym_open.evaluate import a_success
from gym_open.evaluate.human import LOG, HumanConfig, StoppedError, play_as_person
from gym_open.formats.logs import open_log
from tests.children import python

TASK = "goal-seeking"


def press(key: int) -> None:
    """Press and release a key within one frame."""
    for kind in (pygame.KEYDOWN, pygame.KEYUP):
        pygame.event.post(pygame.event.Event(kind, key=key, unicode="", mod=0, scancode=0))


@pytest.fixture(scope="module")
def at_keyboard() -> Iterator[Callable[[Iterator[int | None]], None]]:
    """Give the window these keys whenever it waits; None closes it."""
    from gym_open.evaluate import human, human_window

    wait = human_window.PlayWindow.next_move
    patch = pytest.MonkeyPatch()
    patch.setenv("SDL_VIDEODRIVER", "dummy")  # no screen is needed
    patch.setattr(human_window, "FRAMES_PER_S", 100_000)
    patch.setattr(human, "PAUSE_S", 0)

    def sits_down(keys: Iterator[int | None]) -> None:
        def pressed(window: Any, caption: str) -> int | None:
            if not window._moves:
                key = next(keys)
                pygame.event.post(pygame.event.Event(pygame.QUIT)) if key is None else press(key)
            return wait(window, caption)

        patch.setattr(human_window.PlayWindow, "next_move", pressed)

    yield sits_down
    patch.undo()


@functools.cache
def solution(name: str) -> list[int]:
    """Find keys that solve a puzzle, by trying random moves."""
    from gym_open.evaluate.human_window import KEYS

    env, puzzle = OpenEnv(TASK), puzzle_by_id(name)
    for seed in range(500):
        env.reset(options={"puzzle": puzzle})
        rng = np.random.default_rng(seed)
        actions: list[int] = []
        for action in rng.integers(1, 9, 40):
            actions.append(int(action))
            if env.step(action)[2]:
                return [KEYS[one][seed % len(KEYS[one])] for one in actions]
    raise AssertionError


def played(at_keyboard: Any, out: Path, keys: list[int | None], **changes: Any) -> artefacts.Outcome:
    at_keyboard(iter(keys))
    return play_as_person(HumanConfig(puzzles=(3, 5), player="Ada", **changes), out)


@pytest.fixture(scope="module")
def scores(at_keyboard: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Puzzle 3 solved, puzzle 4 not: a hundred moves against a wall."""
    return played(
        at_keyboard, tmp_path_factory.mktemp("play") / "scores", [*solution(f"{TASK}/003"), *[pygame.K_UP] * 100]
    ).path


def test_every_key_is_one_move_in_its_direction() -> None:
    from gym_open.evaluate.human_window import KEYS

    around = [pygame.K_d, pygame.K_e, pygame.K_w, pygame.K_q, pygame.K_a, pygame.K_z, pygame.K_x, pygame.K_c]
    assert [KEYS[action][0] for action in range(1, 9)] == around  # as they lie on the keyboard, counter-clockwise
    pad = {KEYS[action][-1]: c.MOVES[action] for action in KEYS}
    for row, keys in zip((1, 0, -1), ((7, 8, 9), (4, None, 6), (1, 2, 3)), strict=True):
        for column, key in zip((-1, 0, 1), keys, strict=True):
            assert key is None or pad[getattr(pygame, f"K_KP{key}")] == (column, row)


def test_what_a_person_played_is_scored_like_a_policy(scores: Path) -> None:
    artefacts.verify(scores, "scores")
    record = msgspec.json.decode((scores / "scores.json").read_bytes())
    steps = len(solution(f"{TASK}/003"))
    expected = a_success(np.arange(1, 101) >= steps) / 2
    assert record["a_success"] == pytest.approx(expected)
    assert (record["agent"], record["player"], record["task"]) == ("human", "Ada", TASK)
    assert record["mean_steps"] == (steps + 100) / 2
    assert record["proof"]["verdict"] == "no encoder"
    assert artefacts.lineage(scores).facts["player"] == "Ada"
    table = pq.read_table(scores / "episodes.parquet").to_pydict()
    assert table["puzzle"] == [f"{TASK}/003", f"{TASK}/004"]
    assert table["terminated"] == [True, False]
    assert table["actions"][1] == [3] * 100
    assert table["rewards"][0] == [0.0] * (steps - 1) + [1.0]


def test_what_a_person_played_is_logged_like_any_play(scores: Path) -> None:
    log = open_log(scores / LOG)
    table = pq.read_table(scores / "episodes.parquet").to_pydict()
    first, second = log.segments()
    assert [segment.puzzle for segment in (first, second)] == list(puzzles_of(TASK, "test")[3:5])
    assert [segment.ended for segment in (first, second)] == ["terminated", "budget"]
    assert [segment.actions.tolist() for segment in (first, second)] == table["actions"]
    assert np.isnan(first.intrinsic_reward).all()
    world = World()
    world.load(first.puzzle, recolour_hits=True)
    for action, image, state in zip(first.actions, first.images[1:], first.object_state[1:], strict=True):
        world.step(int(action))
        assert np.array_equal(world.observe(), image)
        assert np.array_equal(world.object_state(), state)


def test_a_played_log_can_be_looked_at(scores: Path, tmp_path: Path) -> None:
    from gym_open.viz.config import VizConfig
    from gym_open.viz.recording import visualize

    assert visualize(VizConfig(), scores / LOG, tmp_path / "play.rrd").stat().st_size > 10_000


def test_no_release_is_made_of_a_played_log(scores: Path, tmp_path: Path) -> None:
    """Neither from the scores, nor from a log artefact with that file."""
    with pytest.raises(ArtefactError, match="expected an artefact of kind 'log', got 'scores'"):
        build_release(ReleaseConfig(), [scores], tmp_path / "release")

    def smuggle(folder: Path) -> dict[str, Any]:
        shutil.copy(scores / LOG, folder)
        return {"task": "sandbox", "extrinsic_reward": False}

    log = artefacts.build(tmp_path / "log", kind="log", config=Config(), parents=[], work=smuggle).path
    with pytest.raises(ArtefactError, match=r"stream-000-000.mcap: holds puzzles of goal-seeking"):
        build_release(ReleaseConfig(), [log], tmp_path / "release")
    assert not (tmp_path / "release").exists()


def test_a_closed_window_loses_nothing(at_keyboard: Any, scores: Path, tmp_path: Path) -> None:
    """After a stop in the middle of each puzzle, play continues there, and ends like play without a stop."""
    keys: list[int | None] = [*solution(f"{TASK}/003"), *[pygame.K_UP] * 100]
    out = tmp_path / "again"
    first = len(keys) - 100
    for part, message in (
        ([*keys[:1], None], rf"stopped after 0 of 2 puzzles.*continues with {TASK}/003"),
        ([*keys[1 : first + 40], None], rf"stopped after 1 of 2 puzzles.*continues with {TASK}/004"),
    ):
        with pytest.raises(StoppedError, match=message):
            played(at_keyboard, out, part)
        assert not out.exists()
    made = played(at_keyboard, out, keys[first + 40 :])
    assert made.made
    assert artefacts.digest(out) == artefacts.digest(scores)
    assert not played(at_keyboard, out, []).made  # nothing is played twice


@pytest.mark.parametrize("puzzles", [(0, 101), (5, 5), (5, 6), (7, 3)])
def test_a_range_that_is_none_is_refused(tmp_path: Path, puzzles: tuple[int, int]) -> None:
    with pytest.raises(ConfigError, match=rf"key `puzzles`: .*got {puzzles[0]} {puzzles[1]}"):
        play_as_person(HumanConfig(puzzles=puzzles), tmp_path / "scores")


def test_an_unnamed_player_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="key `player`"):
        play_as_person(HumanConfig(player=""), tmp_path / "scores")


def test_without_a_screen_it_says_what_to_do(tmp_path: Path) -> None:
    """SDL would draw into memory, and the person would wait for a window."""
    code = (
        "import sys; from pathlib import Path\n"
        "from gym_open.evaluate.human import HumanConfig, play_as_person\n"
        "play_as_person(HumanConfig(), Path(sys.argv[1]))"
    )
    screens = {"DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER"}
    bare = {name: value for name, value in os.environ.items() if name not in screens}
    done = python(code, tmp_path / "scores", env=bare)
    assert done.returncode == 1
    assert "GymOpenError: no window can be opened: there is no screen; play on a machine with a screen" in done.stderr


@pytest.mark.parametrize("picture", ["sharp", "agent"])
def test_the_window_shows_the_world(
    at_keyboard: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, picture: Any
) -> None:
    """The window, shrunk to 84×84 pixels, is nearly the policy's image."""
    from gym_open.evaluate.human_window import PlayWindow

    shown: list[np.ndarray] = []
    frame = PlayWindow._frame

    def watched(window: Any, caption: str) -> None:
        frame(window, caption)
        shown.append(pygame.surfarray.array3d(window.screen).swapaxes(0, 1))

    monkeypatch.setattr(PlayWindow, "_frame", watched)
    with pytest.raises(StoppedError):
        played(at_keyboard, tmp_path / "scores", [None], picture=picture)
    world = World()
    world.load(puzzle_by_id(f"{TASK}/003"), recolour_hits=True)
    assert shown[0].shape == (672, 672, 3)
    small = shown[0].reshape(84, 8, 84, 8, 3).mean(axis=(1, 3))
    limit = {"sharp": 4.0, "agent": 0.0}[picture]
    assert np.abs(small - world.observe()).mean() <= limit
