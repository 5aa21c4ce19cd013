"""A filter takes the episodes that meet every condition, as they are, and nothing else."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from gym_open import artefacts
from gym_open.datasets import Release, open_release
from gym_open.datasets.build import build_release
from gym_open.datasets.config import FilterConfig, MergeConfig, ReleaseConfig
from gym_open.datasets.derived import derive
from gym_open.datasets.filter import _chosen, filter_release
from gym_open.datasets.merge import merge_releases
from gym_open.datasets.verify import verify_release
from gym_open.envs.constants import WALL_X, WALL_Y
from gym_open.errors import UsageError
from gym_open.formats.releases.content import EPISODE_FACTS, episode_digest

pytestmark = pytest.mark.usefixtures("no_figures")
MakeLog = Callable[..., Path]


@pytest.fixture(scope="module")
def logs(make_log: MakeLog) -> dict[str, Path]:
    return {
        "curl": make_log(lengths=((5, 9, 3), (6, 2, 4)), seed=1, explorer={"world_model": "curl", "reward": "ride"}),
        "unknown": make_log(lengths=((2, 8, 5),), seed=2),
    }


@pytest.fixture(scope="module")
def release(logs: dict[str, Path], no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Release:
    config = ReleaseConfig(max_episode_steps=3)
    out = tmp_path_factory.mktemp("release") / "1.0.0"
    return open_release(build_release(config, list(logs.values()), out).path)


def taken(release: Release, out: Path, **conditions: Any) -> Release:
    config = FilterConfig(name="open/some", **conditions)
    return open_release(filter_release(config, release.root, out).path)


def content(release: Release) -> list[str]:
    """Digests of the episodes, whatever they are numbered."""
    facts: list[Any] = release.episodes[list(EPISODE_FACTS)].to_dict("records")
    features: list[Any] = release.table("content").drop(columns="episode_index").to_dict("records")
    return [episode_digest(*pair) for pair in zip(features, facts, strict=True)]


def expected(release: Release, meets: np.ndarray) -> list[str]:
    assert 0 < meets.sum() < len(meets)
    return [digest for digest, good in zip(content(release), meets, strict=True) if good]


def frames(release: Release, name: str) -> list[np.ndarray]:
    """A feature of each episode, read with pandas' own order."""
    values = release.column(name)
    spans = zip(release.episodes["dataset_from_index"], release.episodes["dataset_to_index"], strict=True)
    return [values[first:stop] for first, stop in spans]


def test_by_explorer_split_and_world(release: Release, tmp_path: Path) -> None:
    rows = release.episodes
    second = taken(release, tmp_path / "second/1.0.0", explorer=("unknown",))
    assert content(second) == expected(release, (rows["explorer"] == "unknown").to_numpy())
    assert second.table("streams")[["stream", "log", "log_stream"]].to_numpy().tolist() == [[0, 0, 0]]
    assert set(second.table("switches")["stream"]) == set(second.table("worlds")["stream"]) == {0}
    val = taken(release, tmp_path / "val/1.0.0", split=("val",))
    assert content(val) == expected(release, (rows["split"] == "val").to_numpy())
    assert val.info["splits"] == {"val": f"0:{len(val.episodes)}"}
    one, two = (min(rows["puzzle"][rows["explorer"] == name]) for name in ("curl+ride", "unknown"))
    both = taken(release, tmp_path / "both/1.0.0", world=(one[:8], two), explorer=("unknown",), split=("train", "val"))
    assert content(both) == expected(
        release, (rows["puzzle"].isin([one, two]) & (rows["explorer"] == "unknown")).to_numpy()
    )


def test_by_contact_and_coverage(release: Release, tmp_path: Path) -> None:
    side = 0.05
    cells = 2 * np.ceil(WALL_X / side) * 2 * np.ceil(WALL_Y / side)
    shares = []
    for state in frames(release, "observation.state"):
        x, y = state[:, 0], state[:, 1]
        inside = (abs(x) <= np.ceil(WALL_X / side) * side) & (abs(y) <= np.ceil(WALL_Y / side) * side)
        places = {(int(i), int(j)) for i, j in np.floor(np.stack([x, y], axis=1)[inside] / side)}
        shares.append(len(places) / cells)
    limit = float(np.unique(shares)[1])
    touching = np.array([episode[:-1].astype(bool).mean() for episode in frames(release, "contact.agent")])
    some = taken(release, tmp_path / "1.0.0", min_contact=0.6, min_coverage=limit)
    meets = np.array(shares) >= limit, touching >= 0.6
    assert all(0 < (meets[0] & meets[1]).sum() < one.sum() < len(one) for one in meets)  # each leaves some out
    assert content(some) == expected(release, meets[0] & meets[1])


def test_what_others_touch_among_themselves_is_no_contact_of_the_agent() -> None:
    frames = {
        "contact.count": np.array([1, 1, 2, 0]),
        "contact.agent": np.array([0, 1, 0, 0]),
        "transition.valid": np.array([True, True, True, False]),
        "observation.state": np.zeros((4, 13)),
    }
    rows = pd.DataFrame({"dataset_from_index": [0], "dataset_to_index": [4]})
    made = cast(Release, SimpleNamespace(root=Path("r"), episodes=rows, numbers=lambda *_: frames))
    assert _chosen(FilterConfig(min_contact=0.33), made).tolist() == [0]
    with pytest.raises(UsageError, match="meets all conditions"):
        _chosen(FilterConfig(min_contact=0.34), made)


def test_a_filter_that_keeps_all_has_the_parents_content(release: Release, tmp_path: Path) -> None:
    kept = taken(release, tmp_path / "1.0.0", explorer=("unknown", "curl+ride"))
    facts = [artefacts.lineage(item.root).facts["content"] for item in (kept, release)]
    assert facts[0] == facts[1]
    assert [parent.digest for parent in artefacts.lineage(kept.root).parents] == [release.digest]


@pytest.mark.slow
def test_a_part_of_a_merge_is_what_was_merged(logs: dict[str, Path], tmp_path: Path) -> None:
    built = [
        build_release(ReleaseConfig(max_episode_steps=3), [log], tmp_path / f"{name}/1.0.0").path
        for name, log in logs.items()
    ]
    merged = merge_releases(MergeConfig(name="open/both"), built[::-1], tmp_path / "both/1.0.0").path
    icm = taken(open_release(merged), tmp_path / "part/1.0.0", explorer=("curl+ride",))
    assert content(icm) == content(open_release(built[0]))
    facts = [artefacts.lineage(path).facts["content"] for path in (icm.root, built[0])]
    assert facts[0] == facts[1]


def test_what_is_left_verifies_even_with_holes(
    release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.datasets.verify.run.check_lerobot", lambda *_: None)
    rows = release.episodes
    kept = np.flatnonzero(rows["piece"] != 1)  # of segments of three pieces, the first and the last
    assert (rows["piece"] == 2).any()
    config = FilterConfig(name="open/holes")
    made = derive(config, "filter", tmp_path / "1.0.0", [(release, kept)], workers=1, replace=False)
    assert verify_release(made.path, replay=False).problems == []


def test_what_is_not_there_is_named(release: Release, tmp_path: Path) -> None:
    for conditions, what in (
        ({"explorer": ("rnd",)}, r"no explorer 'rnd'; give one of curl\+ride, unknown"),
        ({"world": ("ffffffffffff",)}, "no world 'ffffffffffff'; give one of"),
        ({"min_contact": 1.0, "min_coverage": 1.0}, "meets all conditions"),
    ):
        with pytest.raises(UsageError, match=what):
            taken(release, tmp_path / "out/1.0.0", **conditions)
    assert not (tmp_path / "out").exists()
