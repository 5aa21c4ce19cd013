"""The wheel in new environments, as users install it: without a compiler, without this repository's overrides."""

import os
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.verify import verify_release
from gym_open.datasets.verify.readers import VARIABLE
from tests.children import run

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
UV = os.environ.get("UV", "uv")
"""`uv run` says where uv is."""
Install = Callable[..., Path]

PLAY = """
import gymnasium, gym_open, sys
env = gymnasium.make("gym_open/GoalSeeking-v1")
image, _ = env.reset(seed=0)
assert image.shape == env.step(3)[0].shape == (84, 84, 3)
worlds = gymnasium.make_vec("gym_open/Sandbox-v1", num_envs=2)
worlds.reset(seed=0)
worlds.close()
assert not {"torch", "pandas", "rerun"} & set(sys.modules)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    done = run([UV, "build", "--quiet", "--wheel", "--out-dir", out, ROOT])
    assert done.returncode == 0, done.stderr
    (made,) = out.glob("*.whl")
    return made


@pytest.fixture
def install(tmp_path: Path) -> Install:
    """`install("a", "b>=1")` returns the Python of a new environment with these packages, from wheels only."""
    place = tmp_path / "environment"
    at = ["--python", place / "bin/python"]

    def make(*requirements: str, overrides: str = "") -> Path:
        settings = tmp_path / "overrides.txt"
        settings.write_text(overrides)
        here = {"cwd": tmp_path, "env": {**os.environ, "CC": "false", "CXX": "false"}}  # not in the repository
        if not place.exists():
            done = run([UV, "venv", "--quiet", "--python", sys.executable, place], **here)
            assert done.returncode == 0, done.stderr
        words = [UV, "pip", "install", "--quiet", "--only-binary", ":all:", "--overrides", settings, *at]
        done = run([*words, *requirements], **here)
        assert done.returncode == 0, done.stderr
        return place / "bin/python"

    return make


def megabytes(python: Path) -> float:
    folder = python.parent.parent
    return sum(item.lstat().st_size for item in folder.rglob("*") if not item.is_dir()) / 1e6


def command(python: Path, *words: str, cwd: Path) -> tuple[int, str]:
    done = run([python.with_name("gym-open"), *words], cwd=cwd)
    return done.returncode, done.stdout + done.stderr


def test_the_base_package_steps_worlds_and_is_small(wheel: Path, install: Install, tmp_path: Path) -> None:
    python = install(str(wheel))
    assert megabytes(python) < 350
    done = run([python, "-c", PLAY], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert command(python, "puzzle", "show", "tool-use/017", cwd=tmp_path)[0] == 0
    assert command(python, "init", "w", cwd=tmp_path)[0] == 0
    status, said = command(python, "evaluate", cwd=tmp_path / "w")
    assert (status, said.count("\n")) == (2, 1)
    assert "pip install 'gym-open[releases]'" in said


@pytest.mark.usefixtures("no_figures")
def test_logs_and_releases_need_no_torch(
    wheel: Path, install: Install, make_log: Callable[..., Path], tmp_path: Path
) -> None:
    python = install(f"gym-open[releases] @ {wheel.as_uri()}")
    assert megabytes(python) < 650
    assert not list(python.parents[1].glob("lib/*/site-packages/torch*"))
    assert command(python, "init", "w", cwd=tmp_path)[0] == 0
    status, said = command(python, "evaluate", "--task", "goal-seeking", cwd=tmp_path / "w")
    assert status == 0, said
    (scores,) = (tmp_path / "w/evaluate/scores").iterdir()
    status, said = command(python, "score", "verify", str(scores), cwd=tmp_path / "w")
    assert status == 0, said
    log = make_log()
    release = build_release(ReleaseConfig(val_fraction=0.34), [log], tmp_path / "release").path
    for words in (
        ["log", "info", log],
        ["dataset", "info", release],
        ["dataset", "verify", release, "--quick"],
        ["dataset", "export", release, "--out", "train.npz"],
    ):
        status, said = command(python, *map(str, words), cwd=tmp_path)
        assert status == 0, said
    status, said = command(python, "dataset", "build", "--logs", str(log), cwd=tmp_path / "w")
    assert (status, said.count("\n")) == (2, 1)
    assert said.endswith("not installed: pip install 'gym-open[build]'\n")


def test_everything_installs_with_the_newest_torch_and_numpy(wheel: Path, install: Install, tmp_path: Path) -> None:
    versions = "from importlib.metadata import version; print(version('torch'), version('numpy'))"
    before = run([install("torch", "numpy"), "-c", versions]).stdout
    python = install(f"gym-open[all] @ {wheel.as_uri()}")
    assert run([python, "-c", versions]).stdout == before
    code = "from gym_open import extras; extras.check(*(set(extras.MODULES) - {'lerobot'}))"
    done = run([python, "-c", code], cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.usefixtures("no_figures")
def test_lerobot_as_its_makers_declare_it_reads_a_release(
    install: Install, make_log: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an environment of its own, without gym-open. 0.4.4 needs pynput, which would have to be compiled."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["lerobot"]
    asked = [line for line in project if (found := Requirement(line)).name == "lerobot" and found.marker]
    # The torch of the oldest versions fits both, so it is downloaded once.
    python = install(*asked, "torch==2.10.0", overrides="pynput ; sys_platform == 'never'\n")
    assert run([python, "-c", "import gym_open"], cwd=tmp_path).returncode == 1
    release = build_release(ReleaseConfig(val_fraction=0.34), [make_log()], tmp_path / "release").path
    monkeypatch.setenv(VARIABLE, str(python))
    report = verify_release(release, replay=False)
    assert report.problems == []
    assert {check.name: check.outcome for check in report.checks}[
        "readers"
    ] == "LeRobot and pandas read the same frames"
