"""The card says what is in the data, and nothing in the data can write on it."""

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from gym_open.datasets import Release
from gym_open.datasets.documents.card import MEANINGS
from gym_open.datasets.documents.facts import gather
from gym_open.errors import ArtefactError


@pytest.fixture(scope="module")
def text(release: Release) -> str:
    return (release.root / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def front(text: str) -> dict:
    return yaml.safe_load(text.split("---\n")[1])


def cells(text: str, heading: str) -> list[list[str]]:
    """Rows of the first table after some text."""
    lines = text[text.index(heading) :].splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(("| ---", "|---")))
    rows = []
    for line in lines[first + 1 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_front_matter_is_the_hubs(front: dict, release: Release) -> None:
    from huggingface_hub import DatasetCardData

    assert front["license"] == "mit"
    assert front["size_categories"] == ["n<1K"]
    assert "LeRobot" in front["tags"]
    assert DatasetCardData(**front).to_dict()["configs"] == front["configs"]


def test_splits_of_the_card_are_those_of_the_data(front: dict, release: Release) -> None:
    frames = pd.read_parquet(release.root / "data", columns=["index", "episode_index"])
    wanted = frames.merge(release.episodes[["episode_index", "split"]], on="episode_index")
    (config,) = front["configs"]
    for item in config["data_files"]:
        files = [path for pattern in item["path"] for path in release.root.glob(pattern)]
        found = pd.concat([pd.read_parquet(path, columns=["index"]) for path in sorted(files)])
        assert sorted(found["index"]) == sorted(wanted[wanted["split"] == item["split"]]["index"])
    assert [item["split"] for item in config["data_files"]] == ["train", "val"]


def test_counts_are_those_of_pandas(text: str, release: Release) -> None:
    frames = pd.read_parquet(release.root / "data").merge(release.episodes, on="episode_index")
    steps = frames[frames["transition.valid"]]
    for row in cells(text, "## Splits"):
        own = release.episodes[release.episodes["split"] == row[0]]
        counts = [len(own), own["length"].sum(), own["steps"].sum(), own["puzzle"].nunique()]
        assert [int(cell) for cell in row[1:]] == counts
    played = {row[0]: row for row in cells(text, "## Statistics")}
    assert sorted(played) == ["icm", "random"]
    for name, row in played.items():
        own = steps[steps["explorer"] == name]
        assert row[5] == f"{(own['contact.agent'] > 0).mean():.1%}"
    for row in cells(text, "Actions, as a share"):
        own = steps[steps["explorer"] == row[0]]
        shares = own["action.index"].value_counts(normalize=True).reindex(range(9), fill_value=0)
        assert row[1:] == [f"{share:.1%}" for share in shares]
    for row in cells(text, "The explorers' own values"):
        values = steps[steps["explorer"] == row[0]][row[1].strip("`")]
        values = values[np.isfinite(values)].astype(float)
        assert row[2:6] == [f"{x:.4g}" for x in (values.min(), values.median(), values.mean(), values.max())]


def test_what_an_explorer_does_not_have_is_left_out(text: str) -> None:
    rows = {(row[0], row[1]) for row in cells(text, "The explorers' own values")}
    assert ("icm", "`reward_part.forward`") in rows
    assert ("icm", "`world_model.loss`") in rows
    assert not {("random", "`reward_part.forward`"), ("random", "`world_model.loss`")} & rows


def test_visits_are_counted_once_a_frame(release: Release) -> None:
    facts = gather(release)
    inside = np.abs(release.column("observation.state")[:, :2]) < (0.65, 1.15)
    assert sum(one.visits.sum() for one in facts.explorers) == inside.all(axis=1).sum()


@pytest.mark.parametrize("config", ["{", "[]", "null", "[" * 100_000])
def test_a_configuration_that_is_none(release: Release, tmp_path: Path, config: str) -> None:
    folder = tmp_path / "1.0.0"
    shutil.copytree(release.root, folder)
    path = folder / "meta/streams/file-000.parquet"
    streams = pq.read_table(path)
    column = streams.schema.get_field_index("config")
    streams = streams.set_column(column, "config", pa.array([config] * len(streams)))
    pq.write_table(streams, path, use_dictionary=False)
    with pytest.raises(ArtefactError, match="configuration of log 0"):
        gather(Release(folder, "", release.info))


def test_every_feature_is_explained(text: str, release: Release) -> None:
    rows = cells(text, "## What is in it")
    assert [row[0].strip("`") for row in rows] == list(release.info["features"])
    assert all(row[3] for row in rows)
    assert set(MEANINGS) - set(release.info["features"]) == {"reward_part"}


def test_figures_and_files_that_the_card_names_are_there(text: str, release: Release) -> None:
    named = re.findall(r"\]\((figures/[^)]+)\)", text)
    assert len(named) == 4
    for name in [*named, "rebuild/rebuild.sh", "croissant.json", "provenance.json", "meta/digests.json"]:
        assert (release.root / name).is_file()


def test_no_date_no_path(text: str, release: Release) -> None:
    assert "2026" not in text
    assert str(release.root.parent) not in text
    assert "/tmp" not in text


@pytest.mark.slow
def test_the_code_on_the_card_runs(text: str, release: Release, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_DATASETS_OFFLINE", "1")
    monkeypatch.setattr("warnings.filters", [])
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict = {}
    exec(code.replace("PATH/TO/THIS/FOLDER", str(release.root)), names)
    assert len(names["dataset"]) == len(release)
    assert len(names["train"]) == len(release.split("train"))
    assert len(names["table"]) == len(release)
    assert names["windows"]
    assert "lerobot" in sys.modules
