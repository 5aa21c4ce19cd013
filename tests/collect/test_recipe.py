"""docs/explorers.md says how to add a world model and a reward. These tests do so, in a copy of the package."""

import os
import re
import sys
from pathlib import Path
from subprocess import STDOUT

import pytest

import gym_open
from gym_open.formats.logs import log_files, open_log
from gym_open.workspace import template
from tests.children import run

PACKAGE = Path(gym_open.__file__).parent
GUIDE = (template() / "docs/explorers.md").read_text()
BLOCKS = re.findall(r"```(?:python|toml)\n(.*?)```", GUIDE, re.S)
FILES = {path: block for block in BLOCKS for path in re.findall(r"\A# (\S+\.(?:py|toml))\n", block)}
LINES = [block for block in BLOCKS if block.startswith("    ")]
CONFIG = "gym_open/agents/config.py"
AFTER = ('    """Used if `world_model` is `curl`."""\n', '    "counted-ride": "rewards.CountedRide",\n')
"""In `CONFIG`, the end of `WorldModelSections` and the end of `INTRINSIC_REWARDS`."""
SIZE = [
    "--steps", "64", "--streams", "2", "--rollout", "8", "--pool", "2", "--probe", "16", "--threads", "1",
    "--explorer.encoder.features", "16", "--explorer.ppo.minibatch-size", "16", "--explorer.ppo.update-epochs", "1",
]  # fmt: skip


def test_the_guide_adds_one_file_and_one_line_for_each_part() -> None:
    assert list(FILES) == [
        "collect/curl.toml",
        "gym_open/agents/ae.py", "collect/ae-ride.toml",
        "gym_open/agents/change.py", "collect/ae-change.toml",
    ]  # fmt: skip
    assert [line.count("\n") for line in LINES] == [1, 1]
    assert GUIDE.count(f"in `{CONFIG}`") == 3  # once as an announcement, and once for each line


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which `gym_open` is the package with the guide's two parts. Other files are links."""
    root = tmp_path_factory.mktemp("copy")
    agents = root / "gym_open/agents"
    agents.mkdir(parents=True)
    for source in (*PACKAGE.iterdir(), *(PACKAGE / "agents").iterdir()):
        target = root / "gym_open" / source.relative_to(PACKAGE)
        if target not in (agents, root / CONFIG):
            target.symlink_to(source)
    text = (PACKAGE / "agents/config.py").read_text()
    for end, line in zip(AFTER, LINES, strict=True):
        assert text.count(end) == 1
        text = text.replace(end, end + line)
    (root / "collect").mkdir()
    for path, content in {**FILES, CONFIG: text}.items():
        (root / path).write_text(content)
    return root


@pytest.mark.parametrize("name", ["ae-ride", "ae-change"])
def test_what_the_guide_adds_explores(copy: Path, name: str) -> None:
    words = ["collect", "--config", f"collect/{name}.toml", "--out", f"logs/{name}", *SIZE]
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}  # the folder of the compiled code is the package's own
    done = run([sys.executable, "-m", "gym_open.cli", *words], cwd=copy, env=env, stderr=STDOUT)
    assert done.returncode == 0, done.stdout
    assert name.replace("-", "+") in done.stdout
    first, *_ = log_files(copy / "logs" / name)
    log = open_log(first)
    assert log.n_steps == 32
    assert log.reward_parts == {"ae-ride": ("impact",), "ae-change": ("change",)}[name]
    assert sum(segment.intrinsic_reward.sum() for segment in log.segments()) > 0
