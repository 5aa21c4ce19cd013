"""Contact sheets and films are decoded and compared with the puzzles and the played steps."""

from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from gym_open import artefacts
from gym_open.envs import constants as c
from gym_open.envs.look import backend
from gym_open.envs.puzzles import Placement, Puzzle, PuzzleError, arranged
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.world import World
from gym_open.errors import ArtefactError, UsageError
from gym_open.evaluate.config import EvaluateConfig
from gym_open.formats.scores import EPISODES, episodes_schema
from gym_open.viz.render import contact_sheet, episode_video, random_actions, scored_actions

needs_gl = pytest.mark.skipif(
    backend.find_backend() is None,
    reason="no OpenGL here: on Debian, apt-get install libegl1 libopengl0 libgl1-mesa-dri",
)
STRAIGHT = Puzzle("goal-seeking", arranged([Placement("agent", 8, 2), Placement("yellow", 8, 5)]))
"""A puzzle whose goal is touched by the third move to the east."""


def frames_of(path: Path) -> np.ndarray:
    frames: list[np.ndarray] = []
    with av.open(str(path)) as container:
        frames += [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    return np.array(frames)


def is_red(pixels: np.ndarray) -> np.ndarray:
    red, green, blue = (pixels[..., i].astype(int) for i in range(3))
    return (red > 90) & (red > 2.5 * green) & (red > 2 * blue)


def test_a_sheet_shows_each_puzzle_where_it_belongs(tmp_path: Path) -> None:
    puzzles = {f"tool-use/{i:03d}": puzzle for i, puzzle in enumerate(fixed_puzzles("tool-use")[:5])}
    out = contact_sheet(puzzles, tmp_path / "new" / "sheet.png", look="observation", size=168, columns=3)
    assert out == tmp_path / "new" / "sheet.png"
    sheet = np.asarray(Image.open(out))
    gap = 168 // 24
    assert sheet.shape[1] == 3 * (168 + gap) + gap
    pitch = (sheet.shape[0] - gap) // 2  # two rows
    world = World()
    for i, puzzle in enumerate(puzzles.values()):
        top, left = gap + i // 3 * pitch, gap + i % 3 * (168 + gap)
        tile = sheet[top : top + 168, left : left + 168]
        world.load(puzzle)
        np.testing.assert_array_equal(tile[::2, ::2], world.observe())
        agent = world.segmentation() == world.model.geom("agent").id
        assert is_red(tile[::2, ::2])[agent].all()
        label = sheet[top + 168 : top + pitch - gap, left : left + 168]
        assert (label.min(axis=2) < 100).sum() > 50  # ink
    assert (sheet[-pitch:, -168:] == sheet[0, 0]).all()  # no sixth puzzle
    assert list(out.parent.iterdir()) == [out]


@needs_gl
def test_a_handsome_sheet_has_the_agents_red(tmp_path: Path) -> None:
    sheet = np.asarray(Image.open(contact_sheet({"straight": STRAIGHT}, tmp_path / "sheet.png", size=200)))
    assert sheet.shape[1] == 200 + 2 * (200 // 24)
    red = np.argwhere(is_red(sheet))
    assert len(red) > 10
    assert np.ptp(red, axis=0).max() < 20  # a single small object


def test_a_film_has_all_frames_and_shows_motion(tmp_path: Path) -> None:
    out = episode_video(STRAIGHT, [1, 0, 1, 1, 1, 1], tmp_path / "film.mp4", look="observation", size=253, fps=20)
    frames = frames_of(out)
    held = round(0.8 * 20)
    # The fourth action, which is the third move, touches the goal and ends the episode.
    assert len(frames) == 2 * held + 4 * 5
    assert frames.shape[2] == 254  # even
    assert frames.shape[1] % 2 == 0
    across = np.array([np.argwhere(is_red(frame[:253])).mean(axis=0)[1] for frame in frames])
    still, moves = across[:held], across[held : held + 5]
    assert np.ptp(still) < 0.5
    assert (np.diff([still[-1], *moves]) > 0.5).all()  # frames between the steps show the motion
    assert np.ptp(across[held + 5 : held + 10]) < 0.5  # action 0
    turned = frames[-1][:253].astype(int)
    assert ((turned[..., 2] > 120) & (turned[..., 0] < 60)).sum() > 20  # the goal's hit colour
    captions = [frame[260:].min(axis=2) < 100 for frame in (frames[0], frames[-1])]
    assert captions[1].sum() > captions[0].sum() > 50  # action and reward are in the caption after the first step
    assert list(tmp_path.iterdir()) == [out]


def test_a_gif_has_the_same_duration(tmp_path: Path) -> None:
    out = episode_video(STRAIGHT, [3, 5], tmp_path / "film.gif", look="observation", size=84, fps=25)
    with Image.open(out) as film:
        assert film.size == (84, film.size[1])
        shown_s = 0.0
        for i in range(film.n_frames):  # equal frames are stored once and shown longer  # pyright: ignore
            film.seek(i)
            shown_s += film.info["duration"] / 1000
    assert shown_s == pytest.approx((2 * 20 + 2 * 5) / 25, abs=0.1)


@needs_gl
def test_a_handsome_film(tmp_path: Path) -> None:
    frames = frames_of(episode_video(STRAIGHT, [1], tmp_path / "film.mp4", size=160, fps=5, frames_per_step=2))
    assert len(frames) == 2 * 4 + 2
    assert is_red(frames[0]).sum() > 5


def test_wrong_use_is_refused_before_drawing(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"film\.avi: expected a file name that ends in \.mp4 or \.gif, got '\.avi'"):
        episode_video(STRAIGHT, [1], tmp_path / "film.avi")
    with pytest.raises(UsageError, match=r"\.png, got none"):
        contact_sheet({"a": STRAIGHT}, tmp_path / "sheet")
    with pytest.raises(UsageError, match="at least one puzzle"):
        contact_sheet({}, tmp_path / "sheet.png")
    with pytest.raises(UsageError, match="3 does not divide the 10 substeps"):
        episode_video(STRAIGHT, [1], tmp_path / "film.mp4", frames_per_step=3)
    with pytest.raises(UsageError, match="size: expected 32 to 2048, got 0"):
        contact_sheet({"a": STRAIGHT}, tmp_path / "sheet.png", size=0)
    with pytest.raises(UsageError, match="size: expected 32 to 2048, got 4000"):
        episode_video(STRAIGHT, [1], tmp_path / "film.mp4", size=4000)
    assert not list(tmp_path.iterdir())


def test_a_film_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected 0 to 8, got 9"):
        episode_video(STRAIGHT, [1, 9], tmp_path / "film.mp4", look="observation", size=84)
    assert not list(tmp_path.iterdir())


def test_random_actions_fill_the_budget_and_are_reproducible() -> None:
    actions = random_actions(STRAIGHT, np.random.default_rng(3))
    assert actions == random_actions(STRAIGHT, np.random.default_rng(3))
    assert len(actions) == 100
    assert set(actions) == set(range(c.N_ACTIONS))
    free = Puzzle("sandbox", STRAIGHT.objects)
    assert len(random_actions(free, np.random.default_rng(0), 7)) == 7
    with pytest.raises(PuzzleError, match="no step budget"):
        random_actions(free, np.random.default_rng(0))


def test_actions_of_scores(tmp_path: Path) -> None:
    def work(partial: Path) -> dict[str, object]:
        row = {"digest": "", "a_success": 0.0, "return": 0.0, "steps": 1, "terminated": False, "rewards": [0.0]}
        rows = [{**row, "puzzle": f"avoidance/{i:03d}", "actions": actions} for i, actions in enumerate([[1, 2], [3]])]
        pq.write_table(pa.Table.from_pylist(rows, schema=episodes_schema()), partial / EPISODES)
        return {}

    artefacts.build(tmp_path / "scores", kind="scores", config=EvaluateConfig(task="avoidance"), parents=[], work=work)
    assert scored_actions(tmp_path / "scores", "avoidance/001") == [3]
    with pytest.raises(
        ArtefactError, match="no episode of puzzle avoidance/002; it holds avoidance/000 to avoidance/001"
    ):
        scored_actions(tmp_path / "scores", "avoidance/002")
