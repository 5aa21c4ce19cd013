"""Recordings of logs and releases are read back and compared with their sources."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.envs.constants import CELL_0, PITCH
from gym_open.formats.logs import Segment, log_files, open_logs
from gym_open.formats.pngs import decode_png
from gym_open.viz import streams, viewers
from gym_open.viz.config import Choice, VizConfig

PARTS = ("forward", "inverse")
NUMBERS = {
    "intrinsic_reward": "intrinsic_reward",
    "world_model_loss": "world_model_loss",
    "entropy": "policy_entropy",
    "value": "value",
    "action": "actions",
}
MakeLog = Callable[..., Path]


def recorded(source: Path, save: Path, config: VizConfig | None = None, **picked: Any) -> Path:
    return viewers.save(streams.view(config or VizConfig(), source, Choice(**picked)), save)


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log(reward_parts=PARTS, keyframe_every=4)


@pytest.fixture(scope="module")
def segments(log: Path) -> list[Segment]:
    return list(open_logs(log)[0].segments())


@pytest.fixture(scope="module")
def release(log: Path, no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("release") / "release"
    return build_release(ReleaseConfig(max_episode_steps=5), [log], out).path


@pytest.fixture(scope="module", params=["log", "file", "release"])
def recording(
    request: pytest.FixtureRequest, log: Path, tmp_path_factory: pytest.TempPathFactory, read_back: Any
) -> Any:
    source = {
        "log": lambda: log,
        "file": lambda: log_files(log)[0][0],
        "release": lambda: request.getfixturevalue("release"),
    }[request.param]()
    return read_back(recorded(source, tmp_path_factory.mktemp("rrd") / "play.rrd"))


def test_entities_and_timelines(recording: Any) -> None:
    assert recording.timelines() >= {"step", "sim_time"}
    series = {f"/stream_0/series/{name}" for name in [*NUMBERS, "contacts", "reward_part/forward"]}
    table = {f"/stream_0/table/{name}" for name in ("agent", "yellow", "green", "heavy", "light", "trail", "move")}
    scenery = {f"/stream_0/table/{name}" for name in ("ground", "top", "walls", "pen", "ramp", "patch")}
    others = {f"/stream_0/{name}" for name in ("observation/image", "world", "switches/learned", "events", "threshold")}
    words = {"/stream_0/about/settings", "/about/lineage", "/stream_0/segments"}
    assert recording.entities() >= series | table | scenery | others | words


def test_series_are_the_logs(recording: Any, segments: list[Segment]) -> None:
    columns = {name: [getattr(segment, attribute) for segment in segments] for name, attribute in NUMBERS.items()}
    columns |= {f"reward_part/{part}": [segment.reward_parts[part] for segment in segments] for part in PARTS}
    columns["contacts"] = [np.array([len(step) for step in segment.contacts]) for segment in segments]
    for name, pieces in columns.items():
        found = recording.scalars(f"/stream_0/series/{name}")
        assert list(found) == list(range(24))
        assert np.allclose(list(found.values()), np.concatenate(pieces), rtol=1e-6)  # a release holds float32


def test_sim_time_is_steps_in_seconds(recording: Any) -> None:
    times, values = recording.column("/stream_0/series/action", "Scalars:scalars", index="sim_time")
    seconds = [np.timedelta64(time, "ns") / np.timedelta64(1, "s") for time in times]
    assert np.allclose(seconds, 0.04 * np.arange(len(values)))


def shown(segments: list[Segment], of: Callable[[Segment], np.ndarray]) -> np.ndarray:
    """Observations by step: without the last one of each segment, but with the last one of the stream."""
    return np.concatenate([*(of(segment)[:-1] for segment in segments), of(segments[-1])[-1:]])


def test_images_are_the_logs(recording: Any, segments: list[Segment]) -> None:
    steps, blobs = recording.column("/stream_0/observation/image", "EncodedImage:blob")
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
    recording: Any, segments: list[Segment], kind: str, archetype: str, length: float
) -> None:
    """`green_2` and `heavy_11` are parked in this log, so they are not drawn."""
    names = segments[0].object_names
    there = [i for i, name in enumerate(names) if name.split("_")[0] == kind and name not in {"green_2", "heavy_11"}]
    expected = shown(segments, lambda segment: segment.object_state)[:, there]
    steps, centres = recording.column(f"/stream_0/table/{kind}", f"{archetype}:centers")
    assert steps == list(range(len(expected)))
    assert np.allclose(np.array(centres), expected[:, :, :3], rtol=1e-6)
    _, turns = recording.column(f"/stream_0/table/{kind}", f"{archetype}:quaternions")
    assert np.allclose(np.array(turns)[..., [3, 0, 1, 2]], expected[:, :, 3:7], rtol=1e-6)
    at, labels = recording.column(f"/stream_0/table/{kind}", f"{archetype}:labels")
    assert at == [segment.first_step for segment in segments]
    assert labels == [[names[i] for i in there]] * len(at)
    _, halves = recording.column(f"/stream_0/table/{kind}", f"{archetype}:half_sizes")
    assert np.allclose(halves, [length / 2, 0.05, 0.05])


def test_trail_and_moves_follow_the_agent(recording: Any, segments: list[Segment]) -> None:
    _, strips = recording.column("/stream_0/table/trail", "LineStrips3D:strips")
    agent = shown(segments, lambda segment: segment.object_state)[:, 0, :3]
    assert np.allclose([strip[-1] for (strip,) in strips], agent, rtol=1e-6)
    steps, arrows = recording.column("/stream_0/table/move", "Arrows3D:vectors")
    actions = np.concatenate([segment.actions for segment in segments])
    assert steps == list(range(len(actions)))
    angles = {action: np.arctan2(arrow[0][1], arrow[0][0]) for action, arrow in zip(actions, arrows, strict=True)}
    for action, angle in angles.items():  # 1 is east; the next ones turn left by 45 degrees each
        still = not np.linalg.norm(arrows[actions.tolist().index(action)][0])
        assert still == (action == 0)
        assert still or math.isclose(math.cos(angle - (action - 1) * math.pi / 4), 1.0, abs_tol=1e-6)


def test_coverage_counts_every_step_so_far(recording: Any, segments: list[Segment]) -> None:
    steps, maps = recording.column("/stream_0/coverage", "Tensor:data")
    assert steps == list(range(25))
    after = np.concatenate([segment.object_state[1:, 0, :2] for segment in segments])
    edges_y = [-np.inf, *(CELL_0[1] - PITCH * (np.arange(15, 0, -1) - 0.5)), np.inf]
    edges_x = [-np.inf, *(CELL_0[0] + PITCH * (np.arange(8) + 0.5)), np.inf]
    for step, (item,) in zip(steps, maps, strict=True):
        counted, _, _ = np.histogram2d(after[:step, 1], after[:step, 0], bins=[edges_y, edges_x])
        assert item["shape"] == [16, 9]
        assert np.array_equal(np.reshape(item["buffer"], (16, 9)), counted[::-1])  # far rows first


def test_switches_losses_and_threshold(recording: Any, log: Path) -> None:
    switches = open_logs(log)[0].switches
    found = {reason: recording.scalars(f"/stream_0/switches/{reason}") for reason in ("start", "learned", "budget")}
    assert found["start"] == {0: 0.0}
    assert found["learned"] == {one.step: float(one.to_world) for one in switches if one.reason == "learned"}
    assert found["budget"] == {24: float(switches[-1].from_world)}
    steps, texts = recording.column("/stream_0/events", "TextLog:text")
    assert steps == [switch.step for switch in switches]
    assert [switch.reason in text[0] for switch, text in zip(switches, texts, strict=True)] == [True] * len(switches)
    assert recording.scalars("/stream_0/threshold") == {0: 0.25, 24: 0.25}
    steps, bars = recording.column("/stream_0/world_losses", "BarChart:values")
    lines = recording.column("/stream_0/world_loss", "Scalars:scalars")
    assert steps == lines[0] == [switch.step for switch in switches[1:]]  # no world was visited at the start
    for (bar,), line in zip(bars, lines[1], strict=True):
        assert np.array_equal(bar["buffer"], [0.5, math.nan, 0.25], equal_nan=True)
        assert np.array_equal(line, [0.5, math.nan, 0.25], equal_nan=True)


def test_the_world_lane_is_the_segments(recording: Any, segments: list[Segment]) -> None:
    lane = recording.scalars("/stream_0/world")
    of_step = np.concatenate([[segment.world] * len(segment.actions) for segment in segments])
    assert np.array_equal(of_step[list(lane)], list(lane.values()))
    edges = {step for one in segments for step in (one.first_step, one.first_step + len(one.actions) - 1)}
    assert set(lane) == edges


def test_segments_have_facts(recording: Any, segments: list[Segment]) -> None:
    listed = recording.static("/stream_0/segments", "TextDocument:text")[0]
    for segment in segments:
        entity = f"/stream_0/segments/segment_{segment.index:04d}"
        assert f"[{segment.index}](recording:/{entity})" in listed
        facts = {
            name: recording.static(entity, f"Segment:{name}")[0]
            for name in ("world", "first_step", "steps", "ended", "contacts", "mean_intrinsic_reward")
        }
        assert math.isclose(facts.pop("mean_intrinsic_reward"), segment.intrinsic_reward.mean(), rel_tol=1e-6)
        losses = [recording.static(entity, f"Segment:loss_at_{when}")[0] for when in ("entry", "exit")]
        known = [0.5, math.inf, 0.25][segment.world]
        assert losses == [known if segment.index else math.inf, known]  # no world was visited before the first
        assert facts == {
            "world": segment.world, "first_step": segment.first_step, "steps": len(segment.actions),
            "ended": segment.ended, "contacts": sum(map(len, segment.contacts)),
        }  # fmt: skip


def test_configuration_is_a_document(recording: Any) -> None:
    text = recording.static("/stream_0/about/settings", "TextDocument:text")[0]
    assert "| curriculum.threshold | 0.25 |" in text
    assert '"threshold": 0.25' in text
    assert "# Lineage of" in recording.static("/about/lineage", "TextDocument:text")[0]


def test_contacts_are_arrows(log: Path, segments: list[Segment], tmp_path: Path, read_back: Any) -> None:
    recording = read_back(recorded(log, tmp_path / "play.rrd", stream=0))
    contacts = [contacts for segment in segments for contacts in segment.contacts]
    steps, vectors = recording.column("/stream_0/table/contacts", "Arrows3D:vectors")
    _, origins = recording.column("/stream_0/table/contacts", "Arrows3D:origins")
    _, labels = recording.column("/stream_0/table/contacts", "Arrows3D:labels")
    assert steps == list(range(24))
    assert [len(row) for row in vectors] == [len(row) for row in contacts]
    for step, found in enumerate(contacts):
        assert np.allclose(np.reshape(origins[step], (-1, 3)), np.reshape([one.position for one in found], (-1, 3)))
        per_ns = [np.array(vector) / one.impulse for vector, one in zip(vectors[step], found, strict=True)]
        assert np.allclose(
            np.reshape(per_ns, (-1, 3)), np.reshape([0.006 * np.array(one.normal) for one in found], (-1, 3))
        )
        assert [one.a in label and one.b in label for one, label in zip(found, labels[step], strict=True)] == [
            True
        ] * len(found)


def test_everything_is_thinned_by_the_documented_rule(
    log: Path, segments: list[Segment], tmp_path: Path, read_back: Any
) -> None:
    config = VizConfig(max_images=4, max_poses=8, max_points=11)
    thin = read_back(recorded(log, tmp_path / "thin.rrd", config, stream=0))
    starts = {segment.first_step for segment in segments}
    for limit, entity, component, ends in (
        (4, "/stream_0/observation/image", "EncodedImage:blob", {24}),
        (8, "/stream_0/table/agent", "Ellipsoids3D:centers", {24}),
        (11, "/stream_0/series/value", "Scalars:scalars", set()),
        (4, "/stream_0/coverage", "Tensor:data", {24}),
    ):
        steps, values = thin.column(entity, component)
        assert set(steps) == {step for step in range(24) if step % math.ceil(24 / limit) == 0} | starts | ends
        if component.startswith("Tensor"):
            assert [sum(item["buffer"]) for (item,) in values] == steps  # steps that are not shown count, too


def test_the_trail_has_shown_and_other_steps_of_its_segment_only(
    log: Path, segments: list[Segment], tmp_path: Path, read_back: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.viz.streams.logs.SPAN_STEPS", 3)
    recording = read_back(recorded(log, tmp_path / "trail.rrd", VizConfig(max_poses=6, trail_steps=5), stream=0))
    steps, strips = recording.column("/stream_0/table/trail", "LineStrips3D:strips")
    assert set(steps) == {*range(0, 25, 4)} | {segment.first_step for segment in segments}
    for step, (strip,) in zip(steps, strips, strict=True):
        segment = [item for item in segments if item.first_step <= step][-1]
        path = segment.object_state[: step - segment.first_step + 1, 0, :3][-6:]
        assert np.allclose(strip, path if len(path) > 1 else [path[0]] * 2, rtol=1e-6)


def test_long_segments_are_drawn_in_spans(
    log: Path, segments: list[Segment], tmp_path: Path, read_back: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gym_open.viz.streams.logs.SPAN_STEPS", 5)
    recording = read_back(recorded(log, tmp_path / "pieces.rrd", VizConfig(max_poses=3), stream=0))
    assert list(recording.scalars("/stream_0/series/value")) == list(range(24))
    steps, centres = recording.column("/stream_0/table/agent", "Ellipsoids3D:centers")
    assert set(steps) == {0, 8, 16, 24} | {segment.first_step for segment in segments}
    expected = shown(segments, lambda segment: segment.object_state)[:, :1, :3]
    assert np.allclose(centres, expected[steps], rtol=1e-6)


def test_a_loss_that_is_nan_is_drawn_as_a_gap(make_log: MakeLog, tmp_path: Path, read_back: Any) -> None:
    source = make_log(lengths=((3, 2),), world_model=False)
    recording = read_back(recorded(source, tmp_path / "gap.rrd"))
    assert all(math.isnan(value) for value in recording.scalars("/stream_0/series/world_model_loss").values())
    assert "/stream_0/world_losses" not in recording.entities()
    _, texts = recording.column("/stream_0/events", "TextLog:text")
    assert all("no world model" in text[0] for text in texts[1:])


def test_depth_is_in_metres_and_geoms_have_names(staged_log: Path, tmp_path: Path, read_back: Any) -> None:
    recording = read_back(recorded(staged_log, tmp_path / "deep.rrd"))
    steps, depths = recording.column("/stream_0/observation/depth", "DepthImage:buffer")
    _, geoms = recording.column("/stream_0/observation/segmentation", "SegmentationImage:buffer")
    assert steps == list(range(50))
    context = recording.static("/stream_0/observation/segmentation", "AnnotationContext:context")[0]
    names = {item["class_id"]: item["class_description"]["info"]["label"] for item in context}
    assert (names[27], names[37], names[2**16 - 1]) == ("agent", "heavy_3", "nothing")
    for step, depth, ids in zip(steps, depths, geoms, strict=True):
        metres = np.frombuffer(bytes(depth[0]), "<f4").reshape(84, 84)
        assert np.isinf(metres[0]).all()
        assert (metres[1:] == np.float32(1.0 + step / 100)).all()
        classes = np.frombuffer(bytes(ids[0]), "<u2").reshape(84, 84)
        assert (classes[0] == 2**16 - 1).all()
        assert (classes[1:] == step % 60).all()


@pytest.fixture(scope="module")
def staged_release(staged_log: Path, no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("staged") / "release"
    return build_release(ReleaseConfig(max_episode_steps=7), [staged_log], out).path


def test_a_log_and_its_release_agree_on_what_is_stuck(
    staged_log: Path, staged_release: Path, tmp_path: Path, read_back: Any
) -> None:
    told: list[list[tuple[int, str, str]]] = []
    for source in (staged_log, staged_release):
        recording = read_back(recorded(source, tmp_path / f"{len(told)}.rrd"))
        steps, texts = recording.column("/stream_0/events", "TextLog:text")
        _, levels = recording.column("/stream_0/events", "TextLog:level")
        told.append([(step, text[0], level[0]) for step, text, level in zip(steps, texts, levels, strict=True)])
        segments = [f"/stream_0/segments/segment_{number:04d}" for number in range(2)]
        assert [recording.static(segment, "Segment:times_stuck")[0] for segment in segments] == [1, 0]
    assert told[0] == told[1]
    stuck = [(step, level) for step, text, level in told[0] if text.startswith("agent")]
    assert stuck == [(32, "WARN"), (41, "INFO")]


@pytest.mark.parametrize("kind", ["staged_log", "staged_release"])
@pytest.mark.parametrize(
    ("steps", "at", "words"),
    [
        (range(20, 32), 32, "agent stuck at"),
        (range(32, 41), 41, "agent free again at"),  # got stuck after step 31, which is not shown
        (range(34, 45), 41, "agent free again at"),
    ],
)
def test_selected_steps_have_the_events_after_each_of_them(
    request: pytest.FixtureRequest, tmp_path: Path, read_back: Any, *, kind: str, steps: range, at: int, words: str
) -> None:
    recording = read_back(recorded(request.getfixturevalue(kind), tmp_path / "cut.rrd", steps=steps))
    (found,), ((text,),) = recording.column("/stream_0/events", "TextLog:text")
    assert found == at
    assert text.startswith(words)
