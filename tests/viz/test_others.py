"""Other viewers of our files: Rerun's loader of logs, and LeRobot's viewer of releases."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.formats.logs.reader import log_files, open_logs
from gym_open.formats.releases import open_release
from tests.children import python, run

PROGRAM = [sys.executable, "-m", "rerun_cli"]


ReadBack = Callable[..., Any]


def column(recording: Any, index: str, entity: str, component: str) -> list[Any]:
    """Values of a component that has one value per time."""
    return [value[0] for value in recording.column(entity, component, index)[1]]


@pytest.fixture(scope="module")
def log(make_log: Callable[..., Path]) -> Path:
    return make_log(lengths=((5, 12),), reward_parts=("forward",))


def test_reruns_loader_shows_images_numbers_and_text(log: Path, tmp_path: Path, read_back: ReadBack) -> None:
    ((file,),) = log_files(log)
    words = [*PROGRAM, "mcap", "convert", str(file), "-o", str(tmp_path / "theirs.rrd")]
    done = run(words, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stderr
    theirs = read_back(tmp_path / "theirs.rrd")
    segments = list(open_logs(log)[0].segments())

    pictures = column(theirs, "message_log_time", "/observation/image", "Image:buffer")
    ours = np.concatenate(
        [segments[0].images[:-1], segments[1].images]
    )  # of two images at the same time, the later one is shown
    assert np.array_equal(np.array(pictures, np.uint8).reshape(-1, 84, 84, 3), ours)
    names = ["intrinsic_reward", "world_model_loss", "policy_entropy", "value", "intrinsic_reward/forward"]
    assert theirs.column("/metrics/position", "SeriesLines:names", "message_log_time")[1] == [names] * 17
    rows = np.array(theirs.column("/metrics/position", "Scalars:scalars", "message_log_time")[1])
    for name, numbers in zip(names[:4], rows.T, strict=False):
        expected = np.concatenate([getattr(segment, name) for segment in segments])
        assert np.array_equal(numbers, expected)
    events = column(theirs, "message_log_time", "/events", "TextDocument:text")
    assert events == [
        "step 0: world -1 -> 0 (start)", "step 5: world 0 -> 1 (learned)", "step 17: world 1 -> -1 (budget)",
    ]  # fmt: skip
    steps = column(theirs, "message_log_time", "/step", "gym_open_msgs.msg.Step:message")
    assert [step["action"] for step in steps] == np.concatenate([item.actions for item in segments]).tolist()


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("pictures", ["png", "video"])
def test_rerun_opens_a_release(
    log: Path, pictures: Literal["png", "video"], tmp_path: Path, read_back: ReadBack
) -> None:
    config = ReleaseConfig(max_episode_steps=256, pictures=pictures)
    ours = open_release(build_release(config, [log], tmp_path / "release").path)
    done = run([*PROGRAM, ours.root, "--save", tmp_path / "theirs.rrd", "--port", "0"], stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stderr
    for episode, row in ours.episodes.iterrows():
        theirs = read_back(tmp_path / "theirs.rrd", f"episode_{episode}")
        first, stop = int(row["dataset_from_index"]), int(row["dataset_to_index"])
        frames, states = theirs.column("/observation.state", "Scalars:scalars", "frame_index")
        assert frames == list(range(stop - first))
        assert np.array_equal(np.array(states, np.float32), ours.numbers(first, stop)["observation.state"])
        if pictures == "png":
            files = theirs.column("/observation.image", "EncodedImage:blob", "frame_index")[1]
            assert [bytes(file[0]) for file in files] == ours.pngs(range(first, stop))
        else:
            samples = theirs.column("/observation.image", "VideoStream:sample", "frame_index")[0]
            assert samples == frames


LEROBOT = """
import sys
from pathlib import Path
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts.lerobot_dataset_viz import visualize_dataset
root, out = map(Path, sys.argv[1:])
visualize_dataset(LeRobotDataset("open/explore", root=root, episodes=[1]), 1, save=True, output_dir=out)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_lerobots_viewer_shows_images_actions_and_the_agents_state(
    log: Path, tmp_path: Path, read_back: ReadBack
) -> None:
    release = build_release(ReleaseConfig(max_episode_steps=256), [log], tmp_path / "release").path
    offline = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hf")}
    done = python(LEROBOT, release, tmp_path, env={**os.environ, **offline})
    assert done.returncode == 0, done.stderr
    theirs = read_back(tmp_path / "open_explore_episode_1.rrd")
    ours = open_release(release)
    first, stop = ours.episodes[["dataset_from_index", "dataset_to_index"]].to_numpy()[1].tolist()
    frames = np.arange(first, stop)
    pictures = column(theirs, "frame_index", "/observation.image", "Image:buffer")
    assert np.array_equal(np.array(pictures, np.uint8).reshape(-1, 84, 84, 3), ours.images(frames))
    numbers = ours.numbers(first, stop)
    for entity, name, width in (("action", "action", 9), ("state", "observation.state", 13)):
        if sys.version_info >= (3, 12):  # LeRobot 0.6 logs one entity per vector, 0.4 one entity per number
            drawn = theirs.column(f"/{entity}", "Scalars:scalars", "frame_index")[1]
        else:
            each = [column(theirs, "frame_index", f"/{entity}/{i}", "Scalars:scalars") for i in range(width)]
            drawn = np.array(each).T
        assert np.array_equal(np.array(drawn, np.float32), numbers[name])
    for name in ("next.reward", "next.done"):
        assert set(column(theirs, "frame_index", f"/{name}", "Scalars:scalars")) == {0.0}
