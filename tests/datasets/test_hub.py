"""Releases go to a hub and come back byte for byte; the real client talks to a stand-in of the hub."""

import copy
import importlib.util
import json
import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.hub import pull_release, push_release
from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.files import lock
from tests.children import python

REPO = "someone/explore"
# huggingface_hub 2.4 gives bytes to httpx2 in a way that it calls old.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


def _load(name: str) -> ModuleType:
    """A module beside this one: `tests` is no package, and draccus installs one of that name."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules.setdefault(name, importlib.util.module_from_spec(spec))
    spec.loader.exec_module(module)
    return module


hub_server = _load("hub_server")
Hub = hub_server.Hub


@pytest.fixture(scope="module")
def first(make_log: Callable[..., Path], no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Version 1.0.0 of a release."""
    config = ReleaseConfig(name="open/explore")
    out = tmp_path_factory.mktemp("open") / "explore/1.0.0"
    return build_release(config, [make_log(lengths=((5, 4), (6,)))], out).path


@pytest.fixture(scope="module")
def pushed(first: Path) -> dict[str, Any]:
    """What a hub holds after a push of version 1.0.0."""
    with pytest.MonkeyPatch.context() as patch, hub_server.serve() as served:
        _online(patch)
        push(first, served)
        return served.repos


def _online(patch: pytest.MonkeyPatch) -> None:
    """Without LeRobot: importing it, as verification does in a process of its own, takes seconds."""
    patch.setattr("gym_open.datasets.verify.run.check_lerobot", lambda *_: None)
    patch.setattr("huggingface_hub.constants.HF_HUB_DISABLE_XET", True)  # the stand-in has no Xet storage
    patch.setenv("HF_TOKEN", hub_server.TOKEN)
    patch.setenv("NO_PROXY", "127.0.0.1,localhost")


@pytest.fixture
def release(first: Path, tmp_path: Path) -> Path:
    """Version 1.0.0, to spoil."""
    return Path(shutil.copytree(first, tmp_path / "mine/1.0.0"))


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Hub]:
    _online(monkeypatch)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "cache"))
    with hub_server.serve() as served:
        yield served


@pytest.fixture
def there(hub: Hub, pushed: dict[str, Any]) -> Hub:
    """The hub with version 1.0.0."""
    hub.repos.update(copy.deepcopy(pushed))
    return hub


def push(root: Path, hub: Hub) -> list[str]:
    return push_release(root, REPO, send=True, endpoint=hub.endpoint)


def pull(out: Path, hub: Hub, version: str = "1.0.0") -> Path:
    return pull_release(REPO, version, out, send=True, endpoint=hub.endpoint)


def files(root: Path) -> dict[str, bytes]:
    return {item.relative_to(root).as_posix(): item.read_bytes() for item in root.rglob("*") if item.is_file()}


def published(hub: Hub, tag: str) -> dict[str, bytes]:
    repo = hub.repos[REPO]
    return {name: data for name, data in repo.commits[repo.tags[tag]].items() if name != ".gitattributes"}


def test_without_leave_nothing_touches_the_network(hub: Hub, release: Path, tmp_path: Path) -> None:
    plan = push_release(release, REPO, send=False, endpoint=hub.endpoint)
    assert [line.split()[-1] for line in plan[:-1]] == sorted(files(release))
    out = tmp_path / "there"
    assert pull_release(REPO, "1.0.0", out, send=False, endpoint=hub.endpoint) == out
    assert hub.asked == []
    assert not out.exists()


def test_what_is_pushed_is_pulled_byte_for_byte(hub: Hub, release: Path, tmp_path: Path) -> None:
    assert push(release, hub)[-1].startswith("open/explore 1.0.0 to someone/explore")
    assert published(hub, "v1.0.0") == files(release)
    out = tmp_path / "deep/er/1.0.0"
    assert pull(out, hub) == out
    assert files(out) == files(release)
    assert artefacts.verify(out, "release") == artefacts.digest(release)
    assert list(out.parent.iterdir()) == [out]


def test_pushing_and_pulling_again_changes_nothing(there: Hub, release: Path, tmp_path: Path) -> None:
    before = dict(there.repos[REPO].tags)
    assert "with the same bytes" in push(release, there)[0]
    assert there.repos[REPO].tags == before
    assert not [line for line in there.asked if line.startswith(("PUT", "DELETE"))]
    out = pull(tmp_path / "1.0.0", there)
    there.asked.clear()
    pull(out, there)
    assert not [line for line in there.asked if "/cdn/" in line]


@pytest.mark.slow
def test_a_new_version_replaces_the_files_and_leaves_the_old_tag(
    there: Hub, first: Path, make_log: Callable[..., Path], no_figures: None, tmp_path: Path
) -> None:
    config = ReleaseConfig(name="open/explore", version="2.0.0")
    second = build_release(config, [make_log(seed=1)], tmp_path / "2.0.0").path
    there.repos[REPO].commit({**published(there, "v1.0.0"), "old/stray.txt": b"of somebody else"})
    push(second, there)
    assert published(there, "v2.0.0") == published(there, "v3.0") == files(second)
    assert published(there, "v1.0.0") == files(first)
    assert files(pull(tmp_path / "one", there)) == files(first)
    assert files(pull(tmp_path / "two", there, "2.0.0")) == files(second)


def test_lerobots_tag_moves_to_the_newest_version(there: Hub, first: Path) -> None:
    repo = there.repos[REPO]
    old = repo.commit({"README.md": b"of an earlier version"})
    repo.tags = {"v0.9.0": old, "v3.0": old}
    push(first, there)
    assert repo.tags["v3.0"] == repo.tags["v1.0.0"] != old
    assert repo.tags["v0.9.0"] == old


def test_versions_go_in_their_order(there: Hub, release: Path) -> None:
    repo = there.repos[REPO]
    repo.tags = {"v1.10.0": repo.heads["main"], "v3.0": repo.heads["main"]}
    with pytest.raises(UsageError, match=r"above 1\.0\.0"):
        push(release, there)


def test_an_interrupted_push_is_repeated(hub: Hub, release: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)  # the client tries again for half a minute
    for cut in ("PUT /lfs", "POST /api/datasets/someone/explore/tag"):
        hub.broken = lambda method, path, cut=cut: f"{method} {path}".startswith(cut)
        with pytest.raises(GymOpenError, match="run the same command again"):
            push(release, hub)
        assert hub.repos[REPO].tags == {}
    hub.broken = lambda *_: False
    push(release, hub)
    assert published(hub, "v1.0.0") == published(hub, "v3.0") == files(release)


def test_what_the_hub_does_not_take_is_not_tagged(hub: Hub, release: Path) -> None:
    hub.ignored = frozenset({"LICENSE", "meta/stats.json"})
    with pytest.raises(GymOpenError, match=r"did not take LICENSE, meta/stats\.json as sent"):
        push(release, hub)
    assert hub.repos[REPO].tags == {}


def test_a_damaged_release_is_not_pushed(hub: Hub, release: Path) -> None:
    path = release / "meta/stats.json"
    path.write_bytes(path.read_bytes() + b" ")
    with pytest.raises(ArtefactError, match=r"meta/stats\.json"):
        push(release, hub)
    assert hub.asked == []


def test_a_published_version_is_never_changed(there: Hub, release: Path) -> None:
    repo = there.repos[REPO]
    changed = repo.commit({**published(there, "v1.0.0"), "README.md": b"another card\n"})
    repo.tags["v1.0.0"] = changed
    with pytest.raises(ArtefactError, match=r"v1\.0\.0 is published with other bytes \(README\.md\)"):
        push(release, there)
    repo.tags["v1.0.0"] = repo.commit({**files(release), "data/chunk-000/file-000.parquet": b"PAR1PAR1"})
    with pytest.raises(ArtefactError, match=r"other bytes \(data/chunk-000/file-000\.parquet\)"):
        push(release, there)


def test_a_repository_of_another_name_is_refused(hub: Hub, release: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="must be OWNER/explore"):
        push_release(release, "someone/other", send=True, endpoint=hub.endpoint)
    for name in ("explore", "../explore", "a/b/c", "a b/explore"):
        with pytest.raises(UsageError, match="OWNER/NAME"):
            pull_release(name, "1.0.0", tmp_path / "out", send=True, endpoint=hub.endpoint)
    with pytest.raises(UsageError, match="three numbers"):
        pull(tmp_path / "out", hub, "../1")
    assert hub.asked == []


@pytest.mark.parametrize("name", ["data/chunk-000/file-000.parquet", "meta/info.json", "manifest.json"])
def test_what_comes_garbled_is_refused_and_leaves_nothing(there: Hub, tmp_path: Path, name: str) -> None:
    def garble(path: str, data: bytes) -> bytes:
        return bytes([*data[:-1], data[-1] ^ 1]) if path == name else data

    there.garble = garble
    with pytest.raises(ArtefactError, match=name.rpartition("/")[2]):
        pull(tmp_path / "get/1.0.0", there)
    assert list((tmp_path / "get").iterdir()) == []


def hostile(hub: Hub, **changed: bytes | None) -> None:
    """Move the tag to a commit whose manifest agrees with the changed files."""
    content = {**published(hub, "v1.0.0"), **changed}
    entries = {
        name: artefacts.Entry(sha256=hub_server.sha256(data or b""), bytes=len(data or b""))
        for name, data in content.items()
        if name != "manifest.json"
    }
    kept = {name: data for name, data in content.items() if data is not None}
    kept["manifest.json"] = artefacts.canonical_json(entries)
    hub.repos[REPO].tags["v1.0.0"] = hub.repos[REPO].commit(kept)


@pytest.mark.parametrize("name", ["../outside", "/etc/evil", "data/../../up", "data/run.pkl", ".cache/x", "a\x1b[2J"])
def test_names_that_no_release_has_are_refused(there: Hub, tmp_path: Path, name: str) -> None:
    hostile(there, **{name: b"evil"})
    with pytest.raises(ArtefactError, match="which no release holds"):
        pull(tmp_path / "get/1.0.0", there)
    assert list((tmp_path / "get").iterdir()) == []
    assert not [line for line in there.asked if "resolve" in line and "manifest.json" not in line]


def test_another_release_under_the_tag_is_refused(there: Hub, tmp_path: Path) -> None:
    info = json.loads(published(there, "v1.0.0")["meta/info.json"])
    for field, value in (("name", "open/other"), ("version", "9.0.0"), ("name", 5), ("version", "../..")):
        told = {**info, "gym_open": {**info["gym_open"], field: value}}
        hostile(there, **{"meta/info.json": json.dumps(told).encode()})
        with pytest.raises(ArtefactError, match=r"do not trust this source|expected NAMESPACE/NAME and X\.Y\.Z"):
            pull(tmp_path / "get/1.0.0", there)
        assert list((tmp_path / "get").iterdir()) == []
    assert not [line for line in there.asked if ".parquet" in line]


def test_files_that_hide_behind_a_good_manifest_are_never_asked_for(there: Hub, first: Path, tmp_path: Path) -> None:
    repo = there.repos[REPO]
    repo.tags["v1.0.0"] = repo.commit({**published(there, "v1.0.0"), "evil.py": b"import os"})
    assert files(pull(tmp_path / "1.0.0", there)) == files(first)


def test_a_release_that_does_not_verify_is_refused(there: Hub, tmp_path: Path) -> None:
    hostile(there, **{"data/chunk-000/file-000.parquet": b"PAR1" + b"\xff" * 64 + b"PAR1"})
    with pytest.raises(ArtefactError):
        pull(tmp_path / "get/1.0.0", there)
    assert list((tmp_path / "get").iterdir()) == []


def test_missing_and_mis_sized_files_are_refused_before_a_byte_comes(there: Hub, tmp_path: Path) -> None:
    good = published(there, "v1.0.0")
    repo = there.repos[REPO]
    for changed in ({"LICENSE": None}, {"meta/stats.json": b"{}"}, {"manifest.json": None}):
        kept = {name: data for name, data in {**good, **changed}.items() if data is not None}
        repo.tags["v1.0.0"] = repo.commit(kept)
        with pytest.raises(ArtefactError, match=next(iter(changed))):
            pull(tmp_path / "get/1.0.0", there)
    assert not [line for line in there.asked if "resolve" in line and "manifest.json" not in line]


def test_an_interrupted_pull_goes_on(there: Hub, first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)
    out = tmp_path / "get/1.0.0"
    there.broken = lambda _, path: path.endswith("file-000.parquet") and "worlds" in path
    with pytest.raises(GymOpenError, match="run the same command again"):
        pull(out, there)
    assert [item.name for item in out.parent.iterdir()] == [".1.0.0.pull.partial"]
    there.broken = lambda *_: False
    data = out.parent / ".1.0.0.pull.partial/data/chunk-000/file-000.parquet"
    there.asked.clear()
    pull(out, there)
    assert not [line for line in there.asked if "resolve" in line and "/data/" in line], data
    assert files(out) == files(first)


def test_what_an_interrupted_pull_left_is_not_taken_at_its_word(there: Hub, first: Path, tmp_path: Path) -> None:
    """A file of the right name and size, but of other bytes, is fetched again."""
    out, name = tmp_path / "get/1.0.0", "meta/stats.json"
    left = out.parent / ".1.0.0.pull.partial" / name
    left.parent.mkdir(parents=True)
    left.write_bytes(bytes(len((first / name).read_bytes())))
    assert files(pull(out, there)) == files(first)


def test_two_do_not_pull_one_version_at_once(there: Hub, tmp_path: Path) -> None:
    out = tmp_path / "1.0.0"
    with lock(out), pytest.raises(UsageError, match="another gym-open process"):
        pull(out, there)
    assert list(tmp_path.glob(".1.0.0.pull.partial")) == []
    pull(out, there)


@pytest.mark.parametrize("name", ["manifest.json", "signature.json"])
def test_more_bytes_than_the_hub_told_of_are_not_read(there: Hub, tmp_path: Path, name: str) -> None:
    repo = there.repos[REPO]
    repo.tags["v1.0.0"] = repo.commit({"signature.json": b"{}", **published(there, "v1.0.0")})
    there.garble = lambda path, data: data + b" " * (path == name)
    with pytest.raises(ArtefactError, match=rf"{name}: [\d,]+ bytes came, the hub announced"):
        pull(tmp_path / "get/1.0.0", there)
    assert list((tmp_path / "get").iterdir()) == []


def test_what_is_in_the_way_is_left_alone(there: Hub, first: Path, tmp_path: Path) -> None:
    out = tmp_path / "1.0.0"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match="exists and is not"):
        pull(out, there)
    assert files(out) == {"mine.txt": b"mine"}


def test_missing_things_are_said(there: Hub, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"no version 1\.2\.0 there; versions: 1\.0\.0"):
        pull(tmp_path / "out", there, "1.2.0")
    with pytest.raises(GymOpenError, match="no such data set"):
        pull_release("someone/nothing", "1.0.0", tmp_path / "out", send=True, endpoint=there.endpoint)


def test_errors_of_the_network_say_what_to_do_and_tell_no_token(
    hub: Hub, release: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    with pytest.raises(GymOpenError, match="log in") as refused:
        push(release, hub)
    with pytest.raises(GymOpenError, match="cannot be reached") as nobody:
        push_release(release, REPO, send=True, endpoint="http://127.0.0.1:9")
    assert not any("hf_secret" in str(error.value) for error in (refused, nobody))


def test_a_client_that_is_told_to_stay_offline_says_so(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from huggingface_hub.utils import _http

    reset = getattr(_http, "reset_sessions", None) or _http.close_session  # before and from 1.0 on
    with monkeypatch.context() as patch:
        patch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
        reset()
        with pytest.raises(GymOpenError, match="HF_HUB_OFFLINE is set: unset it"):
            pull(tmp_path / "out", hub)
    reset()
    assert hub.asked == []


LOAD = """
import os, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("someone/explore", root=sys.argv[1])
print(len(dataset), dataset[0]["observation.image"].shape[0])
"""


@pytest.mark.slow
@pytest.mark.parametrize("pulled", [True, False])
def test_lerobot_loads_what_was_pulled_and_finds_what_was_pushed(there: Hub, tmp_path: Path, pulled: bool) -> None:
    out = pull(tmp_path / "1.0.0", there) if pulled else tmp_path / "fetched by LeRobot"
    network = {"HF_HUB_OFFLINE": "1"} if pulled else {"HF_ENDPOINT": there.endpoint}
    done = python(textwrap.dedent(LOAD), out, env={**os.environ, "HF_HOME": str(tmp_path / "home"), **network})
    assert done.returncode == 0, done.stderr
    frames = json.loads(published(there, "v1.0.0")["meta/info.json"])["total_frames"]
    assert done.stdout.split() == [str(frames), "3"]
