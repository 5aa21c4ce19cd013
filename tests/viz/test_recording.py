"""Recordings are read back: what they hold is what the log and the release hold."""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr

from gym_open import artefacts
from gym_open.config import Config
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.logs.reader import log_files, open_logs
from gym_open.formats.logs.schemas import Segment
from gym_open.formats.pictures import decode_png
from gym_open.viz.config import VizConfig
from gym_open.viz.recording import visualize

MakeLog = Callable[..., Path]
NUMBERS = {
    "intrinsic_reward": "intrinsic_reward",
    "world_model_loss": "world_model_loss",
    "entropy": "policy_entropy",
    "value": "value",
    "action": "actions",
}


class Recording:
    """A recording read back, a column at a time."""

    def __init__(self, path: Path) -> None:
        self._recording = rr.dataframe.load_recording(str(path))

    def entities(self) -> set[str]:
        return {str(column.entity_path) for column in self._recording.schema().component_columns()}

    def timelines(self) -> set[str]:
        return {column.name for column in self._recording.schema().index_columns()}

    def column(self, entity: str, component: str, index: str = "step") -> tuple[list[Any], list[Any]]:
        """Times and values at which the component of the entity was logged."""
        view = self._recording.view(index=index, contents=entity)
        table = view.select(index, f"{entity}:{component}").read_all()
        times, values = table.column(0).to_pylist(), table.column(1).to_pylist()
        kept = [(time, value) for time, value in zip(times, values, strict=True) if value is not None]
        return [time for time, _ in kept], [value for _, value in kept]

    def static(self, entity: str, component: str) -> Any:
        view = self._recording.view(index="step", contents=entity)
        table: pa.Table = view.select_static(f"{entity}:{component}").read_all()
        return table.column(0).to_pylist()[0]


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log()


@pytest.fixture(scope="module")
def segments(log: Path) -> list[Segment]:
    return list(open_logs(log)[0].segments())


@pytest.fixture(scope="module", params=["log", "file", "release"])
def recording(request: pytest.FixtureRequest, log: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("rrd")
    source = {
        "log": lambda: log,
        "file": lambda: log_files(log)[0][0],
        "release": lambda: build_release(ReleaseConfig(max_episode_steps=5), [log], folder / "release").path,
    }[request.param]()
    return Recording(visualize(VizConfig(), source, folder / "play.rrd"))


def test_entities_and_timelines(recording: Recording) -> None:
    assert recording.timelines() >= {"step", "sim_time"}
    series = {f"/stream_0/series/{name}" for name in [*NUMBERS, "contacts"]}
    table = {f"/stream_0/table/{name}" for name in ("agent", "yellow", "green", "heavy", "light", "trail", "move")}
    scenery = {f"/stream_0/table/{name}" for name in ("top", "walls", "pen", "ramp", "patch")}
    others = {f"/stream_0/{name}" for name in ("observation", "world", "switches", "events", "threshold")}
    assert recording.entities() >= series | table | scenery | others | {"/about/config", "/about/lineage"}


def test_series_are_the_logs(recording: Recording, segments: list[Segment]) -> None:
    for name, attribute in NUMBERS.items():
        steps, values = recording.column(f"/stream_0/series/{name}", "Scalars:scalars")
        expected = np.concatenate([getattr(segment, attribute) for segment in segments])
        assert steps == list(range(len(expected)))
        assert np.allclose(np.ravel(values), expected, rtol=1e-6)  # a release holds float32
    _, counts = recording.column("/stream_0/series/contacts", "Scalars:scalars")
    assert np.ravel(counts).tolist() == [len(step) for segment in segments for step in segment.contacts]


def test_sim_time_is_steps_in_seconds(recording: Recording) -> None:
    times, values = recording.column("/stream_0/series/action", "Scalars:scalars", index="sim_time")
    seconds = [np.timedelta64(time, "ns") / np.timedelta64(1, "s") for time in times]
    assert np.allclose(seconds, 0.04 * np.arange(len(values)))


def shown(segments: list[Segment], of: Callable[[Segment], np.ndarray]) -> np.ndarray:
    """Observations by step: all but the last of each segment, and the stream's last."""
    return np.concatenate([*(of(segment)[:-1] for segment in segments), of(segments[-1])[-1:]])


def test_pictures_are_the_logs(recording: Recording, segments: list[Segment]) -> None:
    steps, blobs = recording.column("/stream_0/observation", "EncodedImage:blob")
    expected = shown(segments, lambda segment: segment.images)
    assert steps == list(range(len(expected)))
    for blob, image in zip(blobs, expected, strict=True):
        assert np.array_equal(decode_png(bytes(blob[0])), image)


@pytest.mark.parametrize(
    ("kind", "archetype", "length"),
    [
        ("agent", "Ellipsoids3D", 0.1),
        ("green", "Ellipsoids3D", 0.1),
        ("heavy", "Boxes3D", 0.1),
        ("push", "Ellipsoids3D", 0.1),
        ("rectangle", "Boxes3D", 0.3),
        ("cone", "Boxes3D", 0.1),
    ],
)
def test_objects_are_where_the_log_says(
    recording: Recording, segments: list[Segment], kind: str, archetype: str, length: float
) -> None:
    """`green_2` and `heavy_11` are parked in this log: they are not drawn."""
    names = segments[0].object_names
    there = [i for i, name in enumerate(names) if name.split("_")[0] == kind and name not in {"green_2", "heavy_11"}]
    expected = shown(segments, lambda segment: segment.object_state)[:, there]
    steps, centres = recording.column(f"/stream_0/table/{kind}", f"{archetype}:centers")
    assert steps == list(range(len(expected)))
    assert np.allclose(np.array(centres), expected[:, :, :3], rtol=1e-6)
    _, turns = recording.column(f"/stream_0/table/{kind}", f"{archetype}:quaternions")
    assert np.allclose(np.array(turns)[..., [3, 0, 1, 2]], expected[:, :, 3:7], rtol=1e-6)
    at, labels = recording.column(f"/stream_0/table/{kind}", f"{archetype}:labels")
    assert set(at) >= {segment.first_step for segment in segments}  # and the pieces of a release
    assert labels == [[names[i] for i in there]] * len(at)
    _, halves = recording.column(f"/stream_0/table/{kind}", f"{archetype}:half_sizes")
    assert np.allclose(halves, [length / 2, 0.05, 0.05])


def test_trail_and_moves_follow_the_agent(recording: Recording, segments: list[Segment]) -> None:
    _, points = recording.column("/stream_0/table/trail", "Points3D:positions")
    assert np.allclose(
        np.array(points)[:, 0], shown(segments, lambda segment: segment.object_state)[:, 0, :3], rtol=1e-6
    )
    steps, arrows = recording.column("/stream_0/table/move", "Arrows3D:vectors")
    actions = np.concatenate([segment.actions for segment in segments])
    assert steps == list(range(len(actions)))
    still = np.linalg.norm(np.array(arrows)[:, 0], axis=1) == 0
    assert np.array_equal(still, actions == 0)


def test_switches_and_threshold(recording: Recording, log: Path) -> None:
    switches = open_logs(log)[0].switches
    steps, worlds = recording.column("/stream_0/switches", "Scalars:scalars")
    assert steps == [switch.step for switch in switches]
    assert np.ravel(worlds).tolist() == [switch.to_world for switch in switches]
    _, texts = recording.column("/stream_0/events", "TextLog:text")
    assert [switch.reason in text[0] for switch, text in zip(switches, texts, strict=True)] == [True] * len(switches)
    steps, levels = recording.column("/stream_0/threshold", "Scalars:scalars")
    assert (steps, np.ravel(levels).tolist()) == ([0, 24], [0.25, 0.25])


def test_the_world_lane_is_the_segments(recording: Recording, segments: list[Segment]) -> None:
    steps, worlds = recording.column("/stream_0/world", "Scalars:scalars")
    of_step = np.concatenate([[segment.world] * len(segment.actions) for segment in segments])
    assert np.array_equal(of_step[steps], np.ravel(worlds))
    assert {0, len(of_step) - 1} <= set(steps)


def test_configuration_is_a_document(recording: Recording) -> None:
    text = recording.static("/about/config", "TextDocument:text")[0]
    assert '"threshold": 0.25' in text or '"max_episode_steps": 5' in text
    assert '"kind"' in recording.static("/about/lineage", "TextDocument:text")[0]


def test_pictures_are_thinned_by_the_stated_rule(log: Path, segments: list[Segment], tmp_path: Path) -> None:
    config = VizConfig(max_images=4, max_poses=8)
    thin = Recording(visualize(config, log, tmp_path / "thin.rrd"))
    total, starts = 24, {segment.first_step for segment in segments}
    for limit, entity, component in (
        (4, "/stream_0/observation", "EncodedImage:blob"),
        (8, "/stream_0/table/agent", "Ellipsoids3D:centers"),
    ):
        every = math.ceil(total / limit)
        steps, _ = thin.column(entity, component)
        assert set(steps) == {step for step in range(total) if step % every == 0} | starts | {total}
    steps, _ = thin.column("/stream_0/series/action", "Scalars:scalars")
    assert len(steps) == total


def test_long_segments_are_drawn_in_pieces(
    log: Path, segments: list[Segment], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.viz.spans._PIECE", 5)
    drawn = Recording(visualize(VizConfig(), log, tmp_path / "pieces.rrd"))
    test_series_are_the_logs(drawn, segments)
    test_pictures_are_the_logs(drawn, segments)
    test_the_world_lane_is_the_segments(drawn, segments)


def test_a_loss_that_is_no_number_is_drawn_as_a_gap(make_log: MakeLog, tmp_path: Path) -> None:
    drawn = Recording(visualize(VizConfig(), make_log(lengths=((4, 3),), world_model=False), tmp_path / "random.rrd"))
    _, losses = drawn.column("/stream_0/series/world_model_loss", "Scalars:scalars")
    assert np.isnan(np.ravel(losses)).tolist() == [True] * 7
    _, texts = drawn.column("/stream_0/events", "TextLog:text")
    assert [text[0] for text in texts] == [
        "begin → world 0 (start); losses none yet; 3 worlds never visited",
        "world 0 → world 1 (learned); no world model",
        "world 1 → end (budget); no world model",
    ]


class Nothing(Config, frozen=True):
    """No settings."""


def artefact(folder: Path, kind: str, files: Mapping[str, Any]) -> Path:
    def work(partial: Path) -> dict[str, Any]:
        for name, content in files.items():
            (partial / name).write_text(json.dumps(content))
        return {}

    return artefacts.build(folder, kind=kind, config=Nothing(), parents=[], work=work).path


def test_a_learning_curve(tmp_path: Path) -> None:
    curve = {"columns": ["step", "mean_return", "entropy"], "rows": [[128, None, 2.0], [256, 0.5, 1.5]]}
    source = artefact(tmp_path / "policy", "policy", {"curve.json": curve})
    drawn = Recording(visualize(VizConfig(), source, tmp_path / "deep" / "curve.rrd"))
    assert drawn.column("/curve/entropy", "Scalars:scalars") == ([128, 256], [[2.0], [1.5]])
    assert drawn.column("/curve/mean_return", "Scalars:scalars") == ([256], [[0.5]])


def test_scores_are_a_curve_over_actions(tmp_path: Path) -> None:
    source = artefact(tmp_path / "scores", "scores", {"scores.json": {"mean_return_within": [0.1, 0.4]}})
    drawn = Recording(visualize(VizConfig(), source, tmp_path / "scores.rrd"))
    assert drawn.column("/curve/mean_return_within", "Scalars:scalars", index="actions") == ([1, 2], [[0.1], [0.4]])


def test_what_cannot_be_drawn_is_refused_and_leaves_nothing(make_log: MakeLog, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UsageError, match=r"must end in \.rrd, got '\.mp4'"):
        visualize(VizConfig(), make_log(lengths=((2,),)), out / "play.mp4")
    with pytest.raises(ArtefactError, match=r"kind 'probe'.*curve\.json"):
        visualize(VizConfig(), artefact(tmp_path / "probe", "probe", {}), out / "play.rrd")
    broken = artefact(tmp_path / "broken", "policy", {"curve.json": {"columns": 3}})
    with pytest.raises(ArtefactError, match="not readable"):
        visualize(VizConfig(), broken, out / "play.rrd")
    cut = make_log(lengths=((9,),))
    ((file,),) = log_files(cut)
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(ArtefactError, match=r"stream-000-000\.mcap"):
        visualize(VizConfig(), cut, out / "play.rrd")
    with pytest.raises(ArtefactError, match=r"stream-000-000\.mcap"):
        visualize(VizConfig(), file, out / "play.rrd")
    assert not out.exists()
