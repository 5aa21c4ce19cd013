"""The conformance pair: a log and a list of its contents, which every reader must find."""

import json
import runpy
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gym_open.formats.logs import open_log
from gym_open.formats.logs import schemas as log_schemas
from tests.children import run

PAIR = Path(__file__).parent / "conformance"
PACKAGES = ("@mcap/core@2.2.2", "@foxglove/rosmsg@5.0.5", "@foxglove/rosmsg2-serialization@3.1.0", "fzstd@0.1.1")


@pytest.fixture(scope="module")
def make() -> dict[str, Any]:
    return runpy.run_path(str(PAIR / "make.py"))


@pytest.fixture(scope="module")
def said() -> dict[str, Any]:
    return json.loads((PAIR / "small.json").read_bytes())


def test_it_has_a_message_of_every_kind_and_is_small(said: dict[str, Any]) -> None:
    found = {message["topic"]: message["type"] for message in said["messages"]}
    assert found == {topic: name for topic, (name, _) in log_schemas.DEFINITIONS.items()}
    assert said["metadata"]["gym-open"]["format"] == log_schemas.FORMAT
    assert (PAIR / "small.mcap").stat().st_size < 100_000


def test_it_is_what_is_written_today(make: dict[str, Any], tmp_path: Path) -> None:
    """Another byte means another version of the format: change `FORMAT` and the documents, then make the pair again."""
    assert make["write"](tmp_path).read_bytes() == (PAIR / "small.mcap").read_bytes()


def test_the_mcap_and_ros2_packages_read_it(make: dict[str, Any], said: dict[str, Any]) -> None:
    assert make["describe"](PAIR / "small.mcap") == said


def test_our_reader_reads_it(said: dict[str, Any]) -> None:
    log = open_log(PAIR / "small.mcap")

    def fields(topic: str) -> list[dict[str, Any]]:
        return [message["fields"] for message in said["messages"] if message["topic"] == topic]

    steps, starts, first = fields(log_schemas.STEP), fields(log_schemas.SEGMENT), 0
    assert [(s.step, s.to_world, s.reason) for s in log.switches] == [
        (s["step"], s["to_world"], s["reason"]) for s in fields(log_schemas.SWITCH)
    ]
    assert [(s.step, s.name, s.began) for s in log.stuck] == [
        (s["step"], s["name"], s["began"]) for s in fields(log_schemas.STUCK)
    ]
    segments = list(log.segments())
    assert [(s.first_step, len(s.actions), s.ended) for s in segments] == [(0, 3, "learned"), (3, 2, "budget")]
    for segment in segments:
        mine = steps[first : first + len(segment.actions)]
        first += len(mine)
        keyframes = [start for start in starts if start["segment"] == segment.index]
        assert [k.segment_step for k in segment.keyframes] == [start["segment_step"] for start in keyframes]
        for keyframe, start in zip(segment.keyframes, keyframes, strict=True):
            assert keyframe.integration_state.tolist() == start["integration_state"]
        assert segment.puzzle.digest == keyframes[0]["puzzle_digest"]
        assert segment.actions.tolist() == [step["action"] for step in mine]
        assert segment.object_state[1:].reshape(len(mine), -1).tolist() == [step["object_state"] for step in mine]
        assert [len(contacts) for contacts in segment.contacts] == [len(step["contacts"]) for step in mine]
        for i, name in enumerate(("forward", "inverse")):
            assert segment.reward_parts[name].tolist() == [step["reward_parts"][i] for step in mine]
        losses = [float(step["world_model_loss"]) for step in mine]
        np.testing.assert_array_equal(segment.world_model_loss, losses)


def test_rerun_shows_its_images_plots_and_events(tmp_path: Path) -> None:
    """The pinned viewer opens a log directly."""
    from rerun.chunk import RrdReader

    program = str(Path(sys.executable).with_name("rerun"))
    save = [program, str(PAIR / "small.mcap"), "--save", str(tmp_path / "x.rrd"), "--port", "0"]
    done = run(save)
    assert done.returncode == 0, done.stderr
    recording = RrdReader(tmp_path / "x.rrd").stream().collect()

    def column(place: str, name: str) -> list[Any]:
        table = recording.reader(index="message_log_time", contents=place).to_arrow_table().sort_by("message_log_time")
        return [value for value in table.column(f"{place}:{name}").to_pylist() if value]

    (last,) = [segment for segment in open_log(PAIR / "small.mcap").segments() if segment.ended == "budget"]
    assert last.depth is not None
    assert last.segmentation is not None
    for place, kind, image in (
        ("/observation/image", "Image", last.images[-1]),
        ("/observation/depth", "DepthImage", last.depth[-1]),
        ("/observation/segmentation", "DepthImage", last.segmentation[-1]),
    ):
        assert bytes(column(place, f"{kind}:buffer")[-1][0]) == image.tobytes()
    assert column("/metrics/position", "SeriesLines:names")[-1] == [
        "intrinsic_reward", "world_model_loss", "policy_entropy", "value", "intrinsic_reward/forward",
        "intrinsic_reward/inverse",
    ]  # fmt: skip
    assert column("/metrics/position", "Scalars:scalars")[-1][3:] == [
        last.value[-1],
        last.reward_parts["forward"][-1],
        -0.5,
    ]
    assert ["step 2: heavy_0 stuck in a corner at (1.90, -1.90, 0.05)"] in column("/events", "TextDocument:text")


@pytest.mark.node
@pytest.mark.skipif(shutil.which("npm") is None or shutil.which("node") is None, reason="needs Node.js")
def test_another_implementation_of_mcap_reads_it(said: dict[str, Any], tmp_path: Path) -> None:
    """In JavaScript: @mcap/core for the container, Foxglove's decoder for the messages."""
    shutil.copy(PAIR / "read.mjs", tmp_path)
    install = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", *PACKAGES]
    done = run(install, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    read = run(["node", "read.mjs", PAIR / "small.mcap"], cwd=tmp_path)
    assert json.loads(read.stdout) == said, read.stderr
