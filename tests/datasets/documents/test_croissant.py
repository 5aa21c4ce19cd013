"""Croissant metadata, read by MLCommons' own library."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import pytest

from gym_open.datasets import Release
from gym_open.datasets.config import Header
from gym_open.datasets.documents.croissant import croissant
from gym_open.files import sha256_file


@pytest.fixture(scope="module")
def dataset(release: Release) -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of rdflib, on itself
        import mlcroissant

        yield mlcroissant.Dataset(jsonld=str(release.root / "croissant.json"))


def records(dataset: Any, name: str) -> pd.DataFrame:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rows = list(dataset.records(name))
    return pd.DataFrame([{key.removeprefix(f"{name}/"): value for key, value in row.items()} for row in rows])


def test_it_validates_without_a_warning(dataset: Any) -> None:
    assert not dataset.metadata.ctx.issues.errors
    assert not dataset.metadata.ctx.issues.warnings
    assert str(dataset.metadata.version) == "1.0.0"
    assert dataset.metadata.date_published.date().isoformat() == "2026-02-03"


def test_frames_load_with_numbers_and_pictures(dataset: Any, release: Release) -> None:
    found = records(dataset, "frames").sort_values("index").reset_index(drop=True)
    assert set(found.columns) == set(release.info["features"])
    assert found["index"].tolist() == list(range(len(release)))
    for name in ("action.index", "contact.agent", "next.truncated", "reward.intrinsic"):
        np.testing.assert_array_equal(found[name].to_numpy(), release.column(name))
    state = np.stack(found["observation.state"].to_numpy())
    np.testing.assert_array_equal(state, release.column("observation.state"))
    loss = found["world_model.loss"].astype(float).to_numpy()
    np.testing.assert_array_equal(loss, release.column("world_model.loss").astype(float))
    pictures = np.stack([np.asarray(picture) for picture in found["observation.image"]])
    np.testing.assert_array_equal(pictures, release.images(np.arange(len(release))))


def test_episodes_and_worlds_load(dataset: Any, release: Release) -> None:
    episodes = records(dataset, "episodes")
    assert episodes["length"].tolist() == release.episodes["length"].tolist()
    assert [name.decode() for name in episodes["puzzle"]] == release.episodes["puzzle"].tolist()
    worlds = records(dataset, "worlds")
    assert [text.decode() for text in worlds["json"]] == release.table("worlds")["json"].tolist()


def test_every_data_file_is_named_with_its_digest(release: Release) -> None:
    document = msgspec.json.decode((release.root / "croissant.json").read_bytes())
    named = {item["contentUrl"]: item for item in document["distribution"] if item["@type"] == "cr:FileObject"}
    files = {path.relative_to(release.root).as_posix(): path for path in release.root.rglob("*.parquet")}
    assert set(named) == set(files)
    for name, path in files.items():
        assert named[name]["sha256"] == sha256_file(path)
        assert named[name]["contentSize"] == f"{path.stat().st_size} B"


def test_the_only_thing_that_can_be_missing_is_a_date(release: Release, tmp_path: Path) -> None:
    header = Header(name=release.name, version="2.0.0", license="cc-by-4.0")
    path = tmp_path / "croissant.json"
    path.write_bytes(msgspec.json.encode(croissant(header, release, "words")))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mlcroissant

        issues = mlcroissant.Dataset(jsonld=str(path)).metadata.ctx.issues
    assert not issues.errors
    assert ["datePublished" in text for text in issues.warnings] == [True]
