"""Behaviour with only some packages installed, and agreement of the lists of packages."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import gym_open
from gym_open import extras
from gym_open.errors import MissingExtraError
from tests.children import python

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PACKAGE = Path(gym_open.__file__).parent
BASE = {"gymnasium", "msgspec", "mujoco", "numba", "numpy", "rich", "tyro"}
"""Modules of the packages that are always installed."""
UNDECLARED = {"llvmlite", "cryptography", "sigstore_models", "markupsafe", "_typeshed"}
"""Come with numba, with model-signing and with jinja2; the last is a type checker's own."""


def requirements(extra: str | None) -> dict[str, Requirement]:
    """Requirements in the metadata, by name, without other extras of gym-open."""
    project = PROJECT["project"]
    lines = project["dependencies"] if extra is None else project["optional-dependencies"][extra]
    found = {canonicalize_name(one.name): one for one in map(Requirement, lines)}
    return {name: one for name, one in found.items() if name != "gym-open"}


def brought_along(extra: str) -> set[str]:
    lines = PROJECT["project"]["optional-dependencies"][extra]
    return {name for line in lines if line.startswith("gym-open[") for name in Requirement(line).extras}


HIDE = """
import sys

class Hidden:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in {} else self.finder.find_spec(name, path, target)

sys.meta_path[:] = [Hidden(finder) for finder in sys.meta_path]
"""


def without(*modules: str, code: str) -> subprocess.CompletedProcess[str]:
    """Runs code in a process that cannot find these modules."""
    return python(HIDE.format(sorted(modules)) + code)


OPTIONAL = [name for names in extras.MODULES.values() for name in names]


def test_the_base_package_steps_worlds_and_shows_help() -> None:
    code = """
import gymnasium, gym_open
from gym_open.cli import main

env = gymnasium.make("gym_open/ToolUse-v1")
image, _ = env.reset(seed=0)
assert image.shape == (84, 84, 3)
env.step(3)
worlds = gymnasium.make_vec("gym_open/Sandbox-v1", num_envs=2)
assert worlds.reset(seed=0)[0].shape == (2, 84, 84, 3)
worlds.close()
assert main(["--help"]) == 0
assert main(["puzzle", "show", "tool-use/017"]) == 0
"""
    done = without(*OPTIONAL, code=code)
    assert done.returncode == 0, done.stderr


COMMANDS = [
    ("run", "train,viz"),
    ("collect --out x", "train"),
    ("log info x", "releases"),
    ("dataset build --logs x", "build"),
    ("dataset verify x", "releases"),
    ("train encoder --release x", "train"),
    ("train policy", "train"),
    ("evaluate", "releases"),
    ("viz x --web", "build"),
    ("render sheet --save x.png", "build"),
    ("play --player x", "play"),
    ("serve", "remote"),
]


def test_a_command_without_its_extra_ends_with_2_and_says_what_to_install(tmp_path: Path) -> None:
    code = f"""
import contextlib, io, json
from pathlib import Path
from gym_open import workspace
from gym_open.cli import main

place = Path({str(tmp_path / "w")!r})
workspace.init(place)
said = []
for words, _ in {COMMANDS!r}:
    with contextlib.redirect_stderr(io.StringIO()) as shown, contextlib.chdir(place):
        said.append((main(words.split()), shown.getvalue()))
print(json.dumps(said))
"""
    done = without(*OPTIONAL, code=code)
    assert done.returncode == 0, done.stderr
    for (words, extra), (status, line) in zip(COMMANDS, json.loads(done.stdout.splitlines()[-1]), strict=True):
        assert status == 2, words
        assert re.fullmatch(rf"error: .+ not installed: pip install 'gym-open\[{extra}\]'\n", line), (words, line)


def test_an_option_that_needs_more_says_so(tmp_path: Path) -> None:
    """`viz` needs Rerun for a window, but not for films."""
    code = f"""
from gym_open.cli import main
from gym_open.viz.config import VizConfig
raise SystemExit(main(["viz", {str(tmp_path)!r}, "--save", "x.rrd"]))
"""
    done = without(*extras.MODULES["viz"], code=code)
    assert (done.returncode, done.stderr) == (2, "error: rerun is not installed: pip install 'gym-open[viz]'\n")


@pytest.mark.parametrize(
    ("code", "extra"),
    [
        ("import gym_open.formats.logs", "releases"),
        ("import gym_open.formats.windows", "releases"),
        ("from gym_open.formats.releases import open_release; open_release(None)", "releases"),
        ("import gym_open; gym_open.load_encoder('x')", "train"),
        ("import gymnasium; gymnasium.make('gym_open:open_puzzle_proc-v0', env_ip='far', port=1)", "remote"),
    ],
)
def test_the_library_says_which_extra_is_missing(code: str, extra: str) -> None:
    done = without(*OPTIONAL, code=code)
    assert done.returncode == 1
    assert re.search(rf"MissingExtraError: .+ not installed: pip install 'gym-open\[{extra}\]'", done.stderr)


def test_a_module_of_no_extra_is_missing_as_ever() -> None:
    with pytest.raises(ModuleNotFoundError, match="No module named 'nobody'") as caught, extras.Named():
        import nobody  # noqa: F401  # pyright: ignore[reportMissingImports]
    assert not isinstance(caught.value, MissingExtraError)


def test_checked_modules_are_those_of_the_declared_packages() -> None:
    names = packages_distributions()
    for extra, modules in extras.MODULES.items():
        if extra == "lerobot" and "lerobot" not in names:
            continue  # it may have an environment of its own
        of = {canonicalize_name(one) for module in modules for one in names[module]}
        assert set(requirements(extra)) <= of, extra
    assert set(extras.MODULES) | {"all"} == set(PROJECT["project"]["optional-dependencies"])
    assert {extra: {below} for extra, below in extras.RESTS_ON.items()} == {
        extra: found for extra in extras.MODULES if (found := brought_along(extra))
    }
    assert brought_along("all") == set(extras.MODULES) - {"releases", "build", "lerobot"}


def test_everything_that_is_imported_is_declared() -> None:
    known = {*sys.stdlib_module_names, *BASE, *OPTIONAL, *UNDECLARED, "gym_open"}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module or ""]
            for name in names:
                assert name.partition(".")[0] in known, (path, name)


def pins(text: str) -> list[Requirement]:
    """The lines `name==version ; marker` of a requirements file, without hashes."""
    return [Requirement(line.rstrip("\\ ")) for line in text.splitlines() if line and line[0] not in " #"]


def test_locked_versions_are_those_of_uv_run_and_within_the_ranges() -> None:
    text = (ROOT / "requirements.txt").read_text()
    locked = pins(text)
    assert [str(one) for one in locked] == [
        str(Requirement(line)) for line in PROJECT["tool"]["uv"]["constraint-dependencies"]
    ]
    assert len(re.findall(r"--hash=sha256:[0-9a-f]{64}", text)) >= len(locked)
    for extra in (None, *extras.MODULES):
        for name, asked in requirements(extra).items():
            versions = [next(iter(one.specifier)).version for one in locked if canonicalize_name(one.name) == name]
            assert versions, name
            assert all(version in asked.specifier for version in versions) or extra == "lerobot", name


def test_the_oldest_versions_are_those_that_the_ranges_begin_with() -> None:
    oldest = {
        canonicalize_name(one.name): next(iter(one.specifier)).version
        for one in pins((ROOT / "tests/packaging/lowest.txt").read_text())
    }
    for extra in (None, *sorted(set(extras.MODULES) - {"lerobot"})):
        for name, asked in requirements(extra).items():
            (lowest,) = [one.version for one in asked.specifier if one.operator == ">="]
            assert Version(oldest[canonicalize_name(name)]) == Version(lowest), name


def test_no_file_of_versions_names_a_host() -> None:
    for name in ("pyproject.toml", "requirements.txt", "tests/packaging/lowest.txt", ".ci/lock", ".ci/run"):
        text = (ROOT / name).read_text()
        assert not re.search(r"://|--index|--find-links|@ ", text), name
