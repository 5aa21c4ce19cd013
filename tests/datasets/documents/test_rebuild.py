"""The way to make a release again: its files, and (slowly) the thing itself."""

import os
import shutil
import sys
import tomllib
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from gym_open import artefacts
from gym_open.config import decode
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import FilterConfig, MergeConfig, ReleaseConfig
from gym_open.datasets.documents.facts import LogFacts
from gym_open.datasets.documents.rebuild import rebuild_files
from gym_open.formats.releases.content import payload_digest
from tests import children

COLLECTED = {"steps": 64, "streams": 1, "seed": 3, "explorer": {"ppo": {"target_kl": None}}, "curriculum": {}}
LOG = LogFacts(0, 0, "random", {**COLLECTED, "sandbox": {}, "log": {}}, 1, 64)
OTHER = LogFacts(1, 0, "unknown", {"seed": 3}, 1, 64)


def test_configurations_come_back_whole() -> None:
    config = ReleaseConfig(name="open/a-b", val_fraction=0.25, seed=2**62)
    files = rebuild_files(config, "build", [LOG, OTHER], [], None)
    assert set(files) == {"build.toml", "log-000.toml", "rebuild.sh"}, "a log that nothing collected has no command"
    assert decode(tomllib.loads(files["build.toml"].decode()), ReleaseConfig, source="test") == config
    assert tomllib.loads(files["log-000.toml"].decode()) == {**LOG.config, "explorer": {"ppo": {}}}


def test_what_toml_cannot_say_is_left_out() -> None:
    log = LogFacts(0, 0, "random", {**LOG.config, "more": [1, None, {"a": None, "b": 2}]}, 1, 64)
    found = tomllib.loads(rebuild_files(ReleaseConfig(), "build", [log], [], None)["log-000.toml"].decode())
    assert found["more"] == [1, {"b": 2}]


def commands(files: dict[str, bytes]) -> list[str]:
    return [line for line in files["rebuild.sh"].decode().splitlines() if line.startswith("gym-open")]


def test_commands(release: Release, tmp_path: Path) -> None:
    build = rebuild_files(ReleaseConfig(), "build", [LOG, OTHER], [], None)
    assert commands(build) == [
        'gym-open collect --config "$here/log-000.toml" --out "$work/logs/000"',
        'gym-open dataset build --config "$here/build.toml" --logs "$log_000" "$log_001" --out "$made"',
    ]
    append = rebuild_files(ReleaseConfig(), "append", [LOG], [], release.root)
    assert commands(append)[-1] == (
        'gym-open dataset build --config "$here/append.toml" --append --logs "$log_000" --previous "$previous" '
        '--out "$made"'
    )
    merge = rebuild_files(MergeConfig(name="a/b"), "merge", [], [release.root, release.root], None)
    (line,) = commands(merge)
    assert line == (
        'gym-open dataset merge "$release_0" "$release_1" --name a/b --version 1.0.0 --license mit '
        '--data-file-mb 100 --out "$made"'
    )
    config = FilterConfig(name="a/b", explorer=("curl+ride", "it's"), min_contact=0.2, split=("val",))
    (line,) = commands(rebuild_files(config, "filter", [], [release.root], None))
    assert """--explorer curl+ride 'it'"'"'s' --min-contact 0.2""" in line
    assert "--split val" in line
    assert "--world" not in line
    followed = rebuild_files(config, "filter", [], [release.root], release.root)["rebuild.sh"].decode()
    assert 'cp -R -- "$previous" "$beside/1.0.0"' in followed
    for number, files in enumerate((build, append, merge)):
        script = tmp_path / f"{number}.sh"
        script.write_bytes(files["rebuild.sh"])
        assert children.run(["sh", "-n", script]).returncode == 0


def run(folder: Path, **more: str) -> CompletedProcess[str]:
    """The script of a release, in a folder of its own, with this Python's commands."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "PYTHON": sys.executable, "OMP_NUM_THREADS": "1", **more}
    return children.run(["sh", folder / "rebuild/rebuild.sh"], cwd=folder.parent, env=env)


def test_a_parent_that_is_another_is_refused(release: Release, tmp_path: Path) -> None:
    """Its digest is what `payload_digest` gives, in a script that needs nothing but Python's own library."""
    other = tmp_path / "open/other/1.0.0"
    shutil.copytree(release.root, other)
    files = rebuild_files(MergeConfig(name="open/both"), "merge", [], [release.root], None)
    assert payload_digest(artefacts.manifest(release.root)).encode() in files["rebuild.sh"]
    script = files["rebuild.sh"].replace(b"gym-open dataset merge", b"echo merged; exit 0; #")
    folder = tmp_path / "open/both/1.0.0"
    (folder / "rebuild").mkdir(parents=True)
    (folder / "rebuild/rebuild.sh").write_bytes(script)
    assert run(folder, RELEASE_0=str(other)).stdout == "merged\n"
    manifest = (other / "manifest.json").read_text()
    (other / "manifest.json").write_text(manifest.replace('"sha256": "', '"sha256": "0', 1))
    failed = run(folder, RELEASE_0=str(other))
    assert failed.returncode == 1
    assert "RELEASE_0=FOLDER" in failed.stderr
    assert run(folder).returncode != 0, "it is not beside this one"


@pytest.mark.slow
def test_a_release_is_made_again_from_its_seed_bit_for_bit(tmp_path: Path) -> None:
    from gym_open.agents.config import ExplorerConfig
    from gym_open.collect.config import CollectConfig, CurriculumConfig
    from gym_open.collect.explore import collect

    played = CollectConfig(
        steps=256, streams=2, pool=3, rollout=32, seed=5, curriculum=CurriculumConfig(rule="interval", interval=64),
        explorer=ExplorerConfig(world_model="none", reward="none"),
    )  # fmt: skip
    log = collect(played, tmp_path / "log").path
    config = ReleaseConfig(name="open/tiny", max_episode_steps=32)
    made = build_release(config, [log], tmp_path / "datasets/open/tiny/1.0.0", workers=1).path
    shutil.rmtree(log)
    first = run(made)
    assert first.returncode == 0, first.stderr
    assert first.stdout.splitlines()[-1] == "same"
    again = open_release(made.parent / "rebuilt/open/tiny/1.0.0", check="bytes")
    assert payload_digest(artefacts.manifest(again.root)) in first.stdout
    (made / "manifest.json").write_text((made / "manifest.json").read_text().replace('"sha256": "', '"sha256": "0', 1))
    assert run(made, WORK="again").stderr.splitlines()[-1].startswith("different: ")
