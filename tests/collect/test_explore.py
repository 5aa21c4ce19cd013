"""Exploration runs: they are reproducible, and their logs describe their worlds exactly."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gym_open import artefacts
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import collect
from gym_open.collect.summary import STUCK
from gym_open.config import to_dict
from gym_open.envs import stuck
from gym_open.envs.constants import CELL_0, COLUMNS, PITCH, ROWS
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.model import build_model
from gym_open.envs.world import World
from gym_open.errors import ConfigError, DivergedError
from gym_open.formats.logs import Log, Segment, log_files, open_log
from gym_open.formats.models import load_encoder
from gym_open.precision import native_precision

pytestmark = [pytest.mark.learning, pytest.mark.usefixtures("scripted")]


def changed(config: CollectConfig, **values: Any) -> CollectConfig:
    """`config` with other values; a section is given as a dictionary."""
    parts = {
        name: msgspec.structs.replace(getattr(config, name), **value) if isinstance(value, dict) else value
        for name, value in values.items()
    }
    return msgspec.structs.replace(config, **parts)


def opened(artefact: Path) -> list[Log]:
    return [open_log(parts) for parts in log_files(artefact)]


@pytest.fixture(scope="module")
def logs(made: Path) -> list[Log]:
    return opened(made)


@pytest.fixture(scope="module")
def segments(logs: list[Log]) -> list[Segment]:
    return [segment for log in logs for segment in log.segments()]


def summary(made: Path) -> dict[str, Any]:
    return json.loads((made / "summary.json").read_text())


def test_the_budget_is_spent_and_logged(made: Path, logs: list[Log]) -> None:
    assert [log.n_steps for log in logs] == [200, 200]
    assert artefacts.lineage(made).facts == {
        "task": "sandbox", "extrinsic_reward": False, "explorer": "curl+ride", "steps": 400,
        "precision": native_precision(),
        "puzzles": sorted(puzzle.digest for puzzle in logs[0].puzzles),
    }  # fmt: skip
    assert {path.name for path in made.iterdir()} == {
        "stream-000-000.mcap", "stream-001-000.mcap", "summary.json", "summary.png", "encoder", "config.json",
        "lineage.json", "manifest.json",
    }  # fmt: skip


def test_the_log_says_how_it_was_made(tiny: CollectConfig, logs: list[Log]) -> None:
    for index, log in enumerate(logs):
        assert log.stream == index
        asked = to_dict(tiny)
        asked["explorer"]["ppo"]["precision"] = native_precision()  # in place of `auto`
        assert log.config == json.loads(artefacts.canonical_json(asked))
        assert log.provenance["seed"] == "3"
        assert log.provenance["code"] == artefacts.code_version("log")
        assert "<mujoco" in log.model_xml
        assert log.reward_parts == ("impact",)


def test_segments_follow_on_one_another(logs: list[Log]) -> None:
    for log in logs:
        segments = list(log.segments())
        assert min(len(segment.actions) for segment in segments) > 0
        ends = np.cumsum([len(segment.actions) for segment in segments])
        assert [segment.first_step for segment in segments] == [0, *ends[:-1]]
        assert [segment.index for segment in segments] == list(range(len(segments)))
        assert [switch.to_world for switch in log.switches] == [*(segment.world for segment in segments), -1]
        assert [switch.reason for switch in log.switches] == ["start", *(segment.ended for segment in segments)]
        assert log.switches[0].world_losses == [np.inf] * 4


def test_every_switch_obeys_the_rule(logs: list[Log]) -> None:
    """From the log alone: the left world was below the threshold, and the entered one had the highest free loss."""
    switches = [(log.stream, switch) for log in logs for switch in log.switches if switch.reason == "learned"]
    assert len(switches) >= 4
    stays = {log.stream: [(s.step, s.to_world) for s in log.switches] for log in logs}
    for stream, switch in switches:
        losses = switch.world_losses
        assert losses[switch.from_world] < 2.25 <= losses[switch.to_world]
        # The other stream's worlds around this step: it may have moved just before or just after.
        elsewhere = stays[1 - stream]
        before = [world for step, world in elsewhere if step < switch.step][-1]
        here = [world for step, world in elsewhere if step == switch.step]
        better = {world for world, loss in enumerate(losses) if loss > losses[switch.to_world]}
        assert better <= {before, *here}


def test_no_two_streams_are_in_one_world(logs: list[Log]) -> None:
    worlds = []
    for log in logs:
        at = np.full(200, -1)
        for switch in log.switches[:-1]:
            at[switch.step :] = switch.to_world
        worlds.append(at)
    assert (worlds[0] != worlds[1]).all()


def test_a_world_that_is_entered_again_continues_from_its_last_state(segments: list[Segment]) -> None:
    left: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    again = 0
    by_time = sorted(segments, key=lambda s: (s.first_step, s.first_step + len(s.actions)))
    for segment in by_time:
        assert segment.continued == (segment.world in left)
        if segment.continued:
            image, state = left[segment.world]
            np.testing.assert_array_equal(segment.images[0], image)
            np.testing.assert_array_equal(segment.object_state[0], state)
            again += 1
        left[segment.world] = segment.images[-1], segment.object_state[-1]
    assert again >= 1


def test_a_log_alone_suffices_to_replay_it_from_any_keyframe(segments: list[Segment]) -> None:
    """Every segment is simulated again from each of its keyframes: states, contacts and pixels are the same."""
    world = World()
    assert sum(len(segment.keyframes) > 1 for segment in segments) >= 3
    for segment in segments:
        steps = [frame.segment_step for frame in segment.keyframes]
        assert steps == list(range(0, len(segment.actions), 16))
        for frame, end in zip(segment.keyframes, [*steps[1:], len(segment.actions)], strict=True):
            world.load(segment.puzzle)
            world.restore_state(frame.integration_state)
            np.testing.assert_array_equal(world.observe(), segment.images[frame.segment_step])
            for t in range(frame.segment_step, end):
                assert world.step(int(segment.actions[t])).contacts == segment.contacts[t]
                np.testing.assert_array_equal(world.object_state(), segment.object_state[t + 1])
                np.testing.assert_array_equal(world.observe(), segment.images[t + 1])


def test_figures_are_sensible(segments: list[Segment]) -> None:
    assert np.concatenate([segment.actions for segment in segments]).max() == 8
    for segment in segments:
        assert (segment.intrinsic_reward >= 0).all()
        np.testing.assert_allclose(segment.intrinsic_reward, segment.reward_parts["impact"])
        assert ((segment.policy_entropy > 0) & (segment.policy_entropy <= np.log(9) + 1e-6)).all()
        assert (segment.world_model_loss > 0).all()
        still = (segment.images[1:] == segment.images[:-1]).all(axis=(1, 2, 3))
        assert not segment.intrinsic_reward[still].any()
        assert len(segment.object_names) == build_model(WorldOptions()).njnt  # every movable body has one free joint


def test_the_summary_agrees_with_the_logs(made: Path, logs: list[Log], segments: list[Segment]) -> None:
    found = summary(made)
    assert (found["steps"], found["ended"], found["explorer"], found["rule"]) == (400, "budget", "curl+ride", "loss")
    assert found["switches"] == sum(switch.reason == "learned" for log in logs for switch in log.switches)
    assert found["reasons"] == {"budget": 2, "learned": found["switches"]}
    for row in found["worlds"]:
        there = [segment for segment in segments if segment.world == row["world"]]
        assert row["visits"] == len(there)
        assert row["steps"] == sum(len(segment.actions) for segment in there)
        assert row["puzzle"] == logs[0].puzzles[row["world"]].digest
    stays = {(row["stream"], row["segment"]): (row["world"], row["steps"], row["ended"]) for row in found["segments"]}
    assert stays == {(s.stream, s.index): (s.world, len(s.actions), s.ended) for s in segments}
    assert [row[0] for row in found["curve"]["rows"]] == list(range(16, 401, 16))
    mean = np.mean([segment.intrinsic_reward.sum() for segment in segments]) * len(segments) / 400
    assert np.mean([row[3] for row in found["curve"]["rows"]]) == pytest.approx(mean, rel=1e-5)


def test_losses_in_the_summary_are_those_of_the_switches(made: Path, logs: list[Log]) -> None:
    for row in summary(made)["segments"]:
        entered, left = logs[row["stream"]].switches[row["segment"] : row["segment"] + 2]
        losses = entered.world_losses[row["world"]], left.world_losses[row["world"]]
        assert (row["loss_at_entry"] or math.inf, row["loss_at_exit"]) == losses


def test_coverage_and_touches_in_the_summary_are_those_of_the_logs(made: Path, segments: list[Segment]) -> None:
    """Counted again from the logged states and contacts."""
    found = summary(made)
    edges_x = CELL_0[0] + PITCH * (np.arange(COLUMNS + 1) - 0.5)
    edges_y = CELL_0[1] + PITCH * (0.5 - np.arange(ROWS + 1))
    at = np.concatenate([segment.object_state[1:, 0, :2] for segment in segments])
    cells = np.histogram2d(at[:, 1], at[:, 0], bins=(edges_y[::-1], edges_x))[0][::-1]
    assert found["coverage"]["cells"] == cells.tolist()
    assert found["coverage"]["share"] == pytest.approx((cells > 0).sum() / (ROWS * COLUMNS))
    touched = [
        {contact.a, contact.b} - {"agent"}
        for segment in segments
        for step in segment.contacts
        for contact in step
        if "agent" in (contact.a, contact.b)
    ]
    for kind in ("wall", "corner", "heavy", "light", "yellow"):
        assert found["touches"][kind] == sum(next(iter(one)).startswith(f"{kind}_") for one in touched)
    assert sum(found["touches"].values()) == len(touched) > 20


def test_the_log_holds_the_final_encoder(made: Path) -> None:
    encoder = load_encoder(made / "encoder")
    assert encoder.config.features == 32
    assert float(encoder.mean_image.abs().sum()) > 0


def test_the_same_again_is_the_same_bytes(tiny: CollectConfig, made: Path, tmp_path: Path) -> None:
    assert artefacts.digest(collect(tiny, tmp_path / "elsewhere" / "again").path) == artefacts.digest(made)


@pytest.mark.usefixtures("no_figure")
def test_another_seed_is_another_log(tiny: CollectConfig, made: Path, tmp_path: Path) -> None:
    other = collect(changed(tiny, seed=4, steps=64), tmp_path / "log").path
    assert set(artefacts.lineage(other).facts["puzzles"]).isdisjoint(artefacts.lineage(made).facts["puzzles"])


@pytest.mark.usefixtures("no_figure")
@pytest.mark.parametrize(("streams", "window"), [(1, 1), (2, 1), (2, 3)])
def test_an_infinite_threshold_ends_the_run_when_all_is_learned(
    tiny: CollectConfig, tmp_path: Path, streams: int, window: int
) -> None:
    """Every world counts as learned after a window of rollouts; then none is left."""
    config = changed(tiny, streams=streams, curriculum={"threshold": 1e6, "window": window})
    log = collect(config, tmp_path / "log").path
    found = summary(log)
    assert found["ended"] == "exhausted"
    assert [row["visits"] for row in found["worlds"]] == [1, 1, 1, 1]
    assert found["steps"] == 4 * 8 * window
    for stream, one in enumerate(opened(log)):
        assert [switch.to_world for switch in one.switches] == [*range(stream, 4, streams), -1]
        assert {switch.reason for switch in one.switches} == {"start", "learned", "exhausted"}


@pytest.mark.usefixtures("no_figure")
def test_random_exploration_that_logs_depth_and_segmentation(tiny: CollectConfig, tmp_path: Path) -> None:
    config = changed(
        tiny, steps=80, explorer={"reward": "none", "world_model": "none"},
        curriculum={"rule": "interval", "interval": 20}, log={"depth": True, "segmentation": True},
    )  # fmt: skip
    log = collect(config, tmp_path / "log").path
    assert not (log / "encoder").exists()
    assert [switch.reason for switch in opened(log)[0].switches] == ["start", "interval", "budget"]
    world = World()
    for segment in (segment for one in opened(log) for segment in one.segments()):
        assert not segment.intrinsic_reward.any()
        assert segment.reward_parts == {}
        assert np.isnan(segment.world_model_loss).all()
        np.testing.assert_allclose(segment.policy_entropy, np.log(9), rtol=1e-6)
        assert segment.integration_state is not None
        assert segment.depth is not None
        assert segment.segmentation is not None
        world.load(segment.puzzle)
        world.restore_state(segment.integration_state)
        for t in range(len(segment.actions) + 1):
            np.testing.assert_array_equal(world.depth(), segment.depth[t])
            np.testing.assert_array_equal(world.segmentation(), segment.segmentation[t])
            if t < len(segment.actions):
                world.step(int(segment.actions[t]))


@pytest.mark.usefixtures("no_figure")
def test_stuck_agents_and_objects_are_logged_and_counted(
    tiny: CollectConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With looser limits, because real cases are rare: two pushes within 20 cm, one push in a corner."""
    for name, value in (("AGENT_PUSHES", 2), ("REACH_M", 0.2), ("CORNER_PUSHES", 1)):
        monkeypatch.setattr(stuck, name, value)
    log = collect(changed(tiny, steps=160), tmp_path / "log").path
    times = Counter[str]()
    for one in opened(log):
        states = {s.index: (s.first_step, s.object_names, s.object_state) for s in one.segments()}
        open_ones: set[tuple[int, str]] = set()
        for turn in one.stuck:
            first, names, state = states[turn.segment]
            assert turn.position == tuple(state[turn.step - first, names.index(turn.name), :3])
            assert turn.kind == ("agent" if turn.name == "agent" else "corner")
            assert ((turn.segment, turn.name) in open_ones) != turn.began
            open_ones ^= {(turn.segment, turn.name)}
            times[turn.kind] += turn.began
        assert not open_ones
    assert times["agent"] >= 5
    found = summary(log)
    assert {kind: row["times"] for kind, row in found["stuck"].items()} == {kind: times[kind] for kind in STUCK}
    assert found["stuck"]["agent"]["steps"] >= times["agent"]
    assert sum(row["stuck"]["agent"]["times"] for row in found["worlds"]) == times["agent"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"streams": 5}, "key `streams`: at most one per world, got 5 for a pool of 4"),
        ({"steps": 1}, "key `steps`: at least one per stream, got 1 for 2 streams"),
        (
            {"explorer": {"world_model": "none", "reward": "none"}},
            (
                "key `curriculum.rule`: loss needs the loss of a world model, and `explorer.world_model` is none; "
                "give one of never, interval, uniform, or a world model"
            ),
        ),
    ],
)
def test_impossible_configurations_are_refused(
    tiny: CollectConfig, tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError) as error:
        collect(changed(tiny, **changes), tmp_path / "log")
    assert str(error.value) == words
    assert list(tmp_path.iterdir()) == []


def test_a_learner_that_diverges_says_when_and_what_to_change(tiny: CollectConfig, tmp_path: Path) -> None:
    ppo = msgspec.structs.replace(tiny.explorer.ppo, learning_rate=1e9)
    words = (
        r"not finite after \d+ steps: learning has diverged; give a lower `explorer\.ppo\.learning_rate`, got 1e\+09"
    )
    with pytest.raises(DivergedError, match=words) as caught:
        collect(changed(tiny, explorer={"ppo": ppo}), tmp_path / "log")
    assert caught.value.exit_code == 1
