"""Every example of docs/loading.md runs as it stands, and gives what our own reader gives."""

import json
import os
import re
import shutil
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from gym_open import artefacts
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.formats.releases import open_release
from gym_open.workspace import template
from tests.children import python

PAGE = template() / "docs/loading.md"
SECTION = re.compile(r"^##+ ([^\n]+)\n(.*?)(?=^##|\Z)", re.MULTILINE | re.DOTALL)
ROOT = "datasets/open/explore/1.0.0"


def examples() -> dict[str, str]:
    """Code by the heading that it stands under."""
    found = {}
    for title, text in SECTION.findall(PAGE.read_text(encoding="utf-8")):
        if blocks := re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            (found[title],) = blocks
    return found


CHECKS = {
    "Our reader": """
        assert len(train) == int((numbers["split"] == "train").sum())
        assert np.array_equal(images, every[train[:64]])
        assert np.array_equal(states[:, :2], np.stack(raw["observation.state"].to_list())[:, :2])
        assert len(streams) == 2
    """,
    "Episodes": """
        assert found.tolist() == [i for i, row in episodes.iterrows() if row["split"] == "train" and row["steps"] >= 2]
        assert lengths == episodes["steps"].to_numpy()[found].tolist()
        first, stop = episodes.iloc[episode.id][["dataset_from_index", "dataset_to_index"]]
        assert np.array_equal(episode.observations, every[first:stop])
        assert np.array_equal(episode.actions, raw["action.index"].to_numpy()[first:stop][:-1])
    """,
    "Windows for training": """
        frames = windows.frames(np.arange(len(windows)))
        assert batch["observation.image"].shape == (16, 4, 84, 84, 3)
        drawn = np.random.default_rng(0)
        for _ in range(3):
            chosen = frames[drawn.choice(len(frames), size=16, replace=False)]
        assert np.array_equal(batch["observation.image"], every[chosen])
        assert np.array_equal(batch["action.index"], raw["action.index"].to_numpy()[chosen])
        assert np.array_equal(window["observation.image"], every[:4])
        assert set(numbers["split"][held_out.frames(np.arange(len(held_out))).ravel()]) == {"val"}
        assert np.array_equal(some["observation.image"], every[frames[[5, 0, 5]]])
    """,
    "Torch": """
        assert pixels.shape == (16, 4, 3, 84, 84)
        order = torch.utils.data.RandomSampler(windows, generator=torch.Generator().manual_seed(0))
        seeded = torch.Generator().manual_seed(0)
        alone = torch.utils.data.DataLoader(windows, batch_size=16, shuffle=True, generator=seeded)
        assert torch.equal(next(iter(alone))["observation.image"], batch["observation.image"])
        known = {bytes(picture) for picture in every}
        assert all(bytes(picture.numpy()) in known for picture in batch["observation.image"].flatten(0, 1))
    """,
    "LeRobot": """
        def picture(tensor):
            return np.round(tensor.numpy() * 255).astype(np.uint8).transpose(1, 2, 0)

        one_hot = np.stack(raw["action"].to_list())
        for i in (0, 7, len(raw) - 1):
            assert np.array_equal(picture(dataset[i]["observation.image"]), every[i])
            assert np.array_equal(dataset[i]["action"], one_hot[i])
        assert all(np.array_equal(picture(item["observation.image"][i]), every[5 + i]) for i in range(3))
        assert np.array_equal(item["action"], one_hot[7:9])
        assert padding.tolist() == [False] * 3
        assert windows[0]["observation.image_is_pad"].tolist() == [True, True, False]
        bounds = episodes[["dataset_from_index", "dataset_to_index"]].to_numpy()[[0, 2]]
        assert [int(some[i]["index"]) for i in range(len(some))] == [i for a, b in bounds for i in range(a, b)]
    """,
    "Hugging Face datasets": """
        chosen = np.flatnonzero(numbers["split"] == "train")
        assert np.array_equal(np.stack([np.asarray(row["observation.image"]) for row in train]), every[chosen])
        assert np.array_equal(actions, raw["action.index"].to_numpy()[chosen])
        held_out = datasets.load_dataset(ROOT, split="val", cache_dir=f"cache/{digest}")
        assert np.array_equal(held_out.with_format("numpy")["index"], np.flatnonzero(numbers["split"] == "val"))
    """,
    "pandas": """
        assert np.array_equal(picture, every[0])
        valid = numbers[numbers["transition.valid"] & (numbers["split"] == "train")]
        assert len(played) == int(numbers["transition.valid"].sum())
        for world, share in touches.items():
            assert share == np.mean(valid["contact.agent"][valid["world"] == world] > 0)
    """,
    "DuckDB": """
        assert np.array_equal(picture, every[7])
        valid = numbers[numbers["transition.valid"]]
        assert visits["steps"].sum() == len(valid)
        for row in visits.to_dict("records"):
            own = valid[(valid["world"] == row["world"]) & (valid["split"] == row["split"])]
            assert row["steps"] == len(own)
            assert abs(row["touching"] - np.mean(own["contact.agent"] > 0)) < 1e-12
    """,
}
DRIVER = """
import json, sys, textwrap, traceback
from pathlib import Path

import numpy as np
import pandas

from gym_open.formats.releases import open_release

ROOT = "datasets/open/explore/1.0.0"
codes, checks = json.loads(Path("examples.json").read_text())
release = open_release(Path(ROOT))
raw = pandas.read_parquet(ROOT + "/data")
episodes = release.episodes
numbers = release.frames.merge(episodes[["episode_index", "world", "split"]], on="episode_index")
every = release.images(range(len(release)))
own = {"every": every, "raw": raw, "episodes": episodes, "numbers": numbers, "np": np, "ROOT": ROOT}
problems = {}
for title, code in codes.items():
    names = {}
    try:
        exec(code, names)
        exec(textwrap.dedent(checks[title]), {**names, **own})
    except BaseException:
        problems[title] = traceback.format_exc()
Path("problems.json").write_text(json.dumps(problems))
"""


def run(code: str, cwd: Path) -> str:
    """What Python code prints in a process of its own: Hugging Face reads its settings when it is first imported."""
    home = {"HF_HOME": str(cwd / "hub"), "OMP_NUM_THREADS": "1"}
    done = python(code, cwd=cwd, env={**os.environ, **home})
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def workspace(make_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the release that the examples read."""
    folder = tmp_path_factory.mktemp("workspace")
    log = make_log(lengths=((12, 30, 9, 6), (8,)), seed=2)
    build_release(ReleaseConfig(val_fraction=0.34), [log], folder / ROOT)
    return folder


@pytest.fixture(scope="module")
def problems(workspace: Path) -> dict[str, str]:
    """What went wrong, by heading."""
    (workspace / "examples.json").write_text(json.dumps([examples(), CHECKS]))
    run(DRIVER, workspace)
    return json.loads((workspace / "problems.json").read_text())


@pytest.mark.parametrize("title", CHECKS)
def test_the_example_runs_and_gives_what_our_reader_gives(problems: dict[str, str], title: str) -> None:
    if title in {"LeRobot", "Hugging Face datasets"} and find_spec("lerobot") is None:
        pytest.skip("LeRobot, which brings Hugging Face's datasets along, is not installed")
    assert title not in problems, problems[title]


def test_every_example_is_checked() -> None:
    assert set(examples()) == set(CHECKS)


def test_loading_leaves_the_release_as_it_was(workspace: Path, problems: dict[str, str]) -> None:
    artefacts.verify(workspace / ROOT, "release")


OLD_DATA = """
import os, sys

how, digest = sys.argv[1:]
os.environ["HF_HUB_OFFLINE"] = "1"
if digest:
    os.environ["HF_DATASETS_CACHE"] = f"cache/{digest}"
if how == "datasets":
    import datasets

    folder = {"cache_dir": f"cache/{digest}"} if digest else {}
    state = datasets.load_dataset(ROOT, split="train", **folder).with_format("numpy")["observation.state"]
else:
    import numpy as np
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("open/explore", root=ROOT)
    state = np.stack([dataset[i]["observation.state"] for i in range(len(dataset))])
print(float(state[0][0]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", ["datasets", "lerobot"])
def test_hugging_face_answers_with_old_data_unless_its_cache_is_named_by_the_digest(
    make_log: Callable[..., Path], tmp_path: Path, how: str
) -> None:
    root = tmp_path / ROOT

    def loaded(digest: str = "") -> float:
        code = f"import sys; sys.argv = ['', {how!r}, {digest!r}]; ROOT = {ROOT!r}\n{OLD_DATA}"
        return float(run(code, tmp_path))

    def build(seed: int) -> float:
        log = make_log(lengths=((12, 30, 9, 6), (8,)), seed=seed)
        shutil.rmtree(root, ignore_errors=True)
        build_release(ReleaseConfig(val_fraction=0.34), [log], root)
        for path in sorted(root.rglob("*")):
            os.utime(path, (0, 0))
        return float(open_release(root).column("observation.state")[0, 0])

    old = build(2)
    assert loaded() == loaded(artefacts.digest(root)) == old
    new = build(3)
    assert new != old
    assert loaded() == old
    assert loaded(artefacts.digest(root)) == new
