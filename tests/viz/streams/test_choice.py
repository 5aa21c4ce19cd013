"""Selected parts of logs and releases, and damaged logs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.logs import log_files, open_logs
from gym_open.formats.releases import open_release
from gym_open.viz import streams, viewers
from gym_open.viz.config import Choice, VizConfig

MakeLog = Callable[..., Path]


@pytest.fixture(scope="module")
def log(make_log: MakeLog) -> Path:
    return make_log(keyframe_every=4)


@pytest.fixture(scope="module")
def release(log: Path, no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("release") / "release"
    return build_release(ReleaseConfig(max_episode_steps=5), [log], out).path


def rewards(source: Path, save: Path, read_back: Any, **picked: Any) -> dict[str, dict[int, float]]:
    recording = read_back(viewers.save(streams.view(VizConfig(), source, Choice(**picked)), save))
    entities = [name for name in recording.entities() if name.endswith("series/intrinsic_reward")]
    return {name.split("/")[1]: recording.scalars(name) for name in sorted(entities)}


def of_log(log: Path, stream: int, steps: range) -> dict[int, float]:
    every = np.concatenate([segment.intrinsic_reward for segment in open_logs(log)[stream].segments()])
    return {step: every[step] for step in steps}


@pytest.mark.parametrize("kind", ["log", "release"])
@pytest.mark.parametrize(
    ("picked", "expected"),
    [
        ({"stream": 1}, {"stream_1": range(6)}),
        ({"steps": range(7, 19)}, {"stream_0": range(7, 19)}),
        ({"segment": 0}, {"stream_0": range(5), "stream_1": range(6)}),
        ({"segment": 1, "steps": range(9, 99)}, {"stream_0": range(9, 17)}),
    ],
)
def test_only_the_selected_part_is_shown(
    request: pytest.FixtureRequest, log: Path, tmp_path: Path, read_back: Any,
    *, kind: str, picked: dict[str, Any], expected: dict[str, range],
) -> None:  # fmt: skip
    found = rewards(request.getfixturevalue(kind), tmp_path / "part.rrd", read_back, **picked)
    assert list(found) == list(expected)
    for name, steps in expected.items():
        assert found[name] == pytest.approx(of_log(log, int(name[-1]), steps), rel=1e-6)


def test_an_episode_of_a_release(release: Path, log: Path, tmp_path: Path, read_back: Any) -> None:
    row = open_release(release).episodes.iloc[3]
    steps = range(int(row["first_step"]), int(row["first_step"] + row["steps"]))
    found = rewards(release, tmp_path / "episode.rrd", read_back, episode=3)
    assert found == {f"stream_{row['stream']}": pytest.approx(of_log(log, int(row["stream"]), steps), rel=1e-6)}


def test_a_selected_part_is_shown_with_its_context(log: Path, tmp_path: Path, read_back: Any) -> None:
    """The context is sizes and names of objects, the last observation, and the losses at the last switch."""
    path = viewers.save(streams.view(VizConfig(), log, Choice(steps=range(7, 19))), tmp_path / "part.rrd")
    recording = read_back(path)
    assert recording.column("/stream_0/table/agent", "Ellipsoids3D:labels")[0] == [7, 17]
    assert recording.column("/stream_0/observation/image", "EncodedImage:blob")[0] == list(range(7, 20))
    assert recording.column("/stream_0/world_losses", "BarChart:values")[0] == [7, 17]
    assert recording.scalars("/stream_0/world") == {7: 1.0, 16: 1.0, 17: 2.0, 18: 2.0}
    text = recording.static("/stream_0/segments", "TextDocument:text")[0]
    assert "Segments of stream 0: 2" in text


@pytest.mark.parametrize(
    ("picked", "message"),
    [
        ({"stream": 7}, r"--stream: .* has the streams 0 to 1, got 7"),
        ({"segment": 9}, r"stream 0: steps 0:24, segments 0 to 3; stream 1: steps 0:6, segments 0"),
        ({"segment": 1, "steps": range(3)}, r"stream 0: steps 0:24, segments 0 to 3, of which 1 is steps 5:17"),
        ({"steps": range(24, 30)}, "no step matches --segment and --steps"),
        ({"episode": 1}, "--episode does not apply to a log"),
    ],
)
def test_a_part_that_does_not_exist_is_refused(log: Path, picked: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        streams.view(VizConfig(), log, Choice(**picked))


def test_an_episode_that_does_not_exist_is_refused(release: Path) -> None:
    with pytest.raises(UsageError, match="has the episodes 0 to 7, got 9"):
        streams.view(VizConfig(), release, Choice(episode=9))
    with pytest.raises(UsageError, match="episode 0 belongs to stream"):
        streams.view(VizConfig(), release, Choice(episode=0, stream=5))


def test_a_damaged_log_is_shown_up_to_the_damage(log: Path, tmp_path: Path, read_back: Any) -> None:
    ((whole,), _) = log_files(log)
    cut = tmp_path / whole.name
    cut.write_bytes(whole.read_bytes()[:-100])  # only the index is cut off: all steps are complete
    recording = read_back(viewers.save(streams.view(VizConfig(), cut, Choice()), tmp_path / "cut.rrd"))
    found = recording.scalars("/stream_0/series/intrinsic_reward")
    assert found == of_log(log, 0, range(24))
    _, texts = recording.column("/stream_0/events", "TextLog:text")
    steps, levels = recording.column("/stream_0/events", "TextLog:level")
    last = max(range(len(steps)), key=lambda i: levels[i][0] == "ERROR")
    assert (steps[last], levels[last]) == (24, ["ERROR"])
    assert "the log is damaged after step 23" in texts[last][0]
    assert "damaged at byte" in recording.static("/stream_0/about/settings", "TextDocument:text")[0]


def test_a_log_without_a_complete_step_is_refused(log: Path, tmp_path: Path) -> None:
    whole = log_files(log)[0][0]
    cut = tmp_path / whole.name
    cut.write_bytes(whole.read_bytes()[:3000])
    with pytest.raises(ArtefactError, match=r"stream-000-000\.mcap"):
        streams.view(VizConfig(), cut, Choice())
