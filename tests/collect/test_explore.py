"""Collecting: reproducible, resumable after kill -9 with nothing lost, and true to the worlds that it logs."""

import inspect
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch

from gym_open import artefacts, seeding
from gym_open.agents.config import EncoderConfig, PPOConfig
from gym_open.agents.explorer import Explorer
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import Exploration, collect
from gym_open.collect.pool import Pool, sample_pool
from gym_open.config import to_dict
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.model import build_model
from gym_open.envs.puzzles.generators import SandboxConfig
from gym_open.envs.puzzles.sets import reserved_digests
from gym_open.envs.world import World
from gym_open.errors import ConfigError, GymOpenError
from gym_open.formats.log_container import Logged, whole_chunks
from gym_open.formats.logs import Log, LogError, Segment, log_files, open_log

TINY = CollectConfig(
    steps=400, streams=2, rollout=8, pool=4, threshold=2.25, window=1, probe=16, checkpoint_every=4, threads=1, seed=3,
    encoder=EncoderConfig(features=32),
    ppo=PPOConfig(learning_rate=1e-3, minibatch_size=16, update_epochs=1, shift_pad=4),
)  # fmt: skip


def scripted_loss(pool: Pool, world: int, explorer: Explorer, rollout: int) -> float:
    """Stands for the world model's loss, so that streams switch, and come back to worlds that they had left."""
    return 2.0 + seeding.integer(1, world, rollout) % 1000 / 1000 if f"seen/{world}" in pool.tensors() else math.inf


REAL_LOSS = Pool.loss


@pytest.fixture(scope="module", autouse=True)
def _script() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pool, "loss", scripted_loss)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return collect(TINY, tmp_path_factory.mktemp("collect") / "log").path


@pytest.fixture(scope="module")
def logs(made: Path) -> list[Log]:
    return [open_log(path) for path in log_files(made)]


@pytest.fixture(scope="module")
def segments(logs: list[Log]) -> list[Segment]:
    return [segment for log in logs for segment in log.segments()]


def summary(made: Path) -> dict[str, Any]:
    return json.loads((made / "summary.json").read_text())


def test_the_budget_is_spent_and_logged(made: Path, logs: list[Log]) -> None:
    assert [log.n_steps for log in logs] == [200, 200]
    assert artefacts.lineage(made).facts == {
        "task": "sandbox", "extrinsic_reward": False, "steps": 400,
        "puzzles": sorted(puzzle.digest for puzzle in logs[0].puzzles),
    }  # fmt: skip
    assert {path.name for path in made.iterdir()} == {
        "stream-000.mcap", "stream-001.mcap", "summary.json", "config.json", "lineage.json", "manifest.json",
    }  # fmt: skip


def test_the_log_says_how_it_was_made(logs: list[Log]) -> None:
    for index, log in enumerate(logs):
        assert log.stream == index
        assert log.config == json.loads(artefacts.canonical_json(to_dict(TINY)))
        assert log.provenance["seed"] == "3"
        assert log.provenance["code"] == artefacts.code_version()
        assert "<mujoco" in log.model_xml


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
    """From the log alone: the left world was under the threshold, the chosen one was not, and no free one above it."""
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


def test_a_world_that_is_entered_again_goes_on_from_where_it_was_left(segments: list[Segment]) -> None:
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


def test_a_log_alone_suffices_to_replay_it(segments: list[Segment]) -> None:
    """Every segment simulated anew from its logged state and actions: states, contacts and pixels are the same."""
    world = World()
    for segment in segments:
        world.load(segment.puzzle)
        world.restore_state(segment.integration_state)
        np.testing.assert_array_equal(world.observe(), segment.images[0])
        for t, action in enumerate(segment.actions):
            assert world.step(int(action)).contacts == segment.contacts[t]
            np.testing.assert_array_equal(world.object_state(), segment.object_state[t + 1])
            np.testing.assert_array_equal(world.observe(), segment.images[t + 1])


def test_figures_are_sensible(segments: list[Segment]) -> None:
    assert np.concatenate([segment.actions for segment in segments]).max() == 8
    for segment in segments:
        assert (segment.intrinsic_reward >= 0).all()
        assert ((segment.policy_entropy > 0) & (segment.policy_entropy <= np.log(9) + 1e-6)).all()
        assert (segment.world_model_loss > 0).all()
        still = (segment.images[1:] == segment.images[:-1]).all(axis=(1, 2, 3))
        assert not segment.intrinsic_reward[still].any()
        assert len(segment.object_names) == build_model(WorldOptions()).njnt  # every movable body has one free joint


def test_the_summary_agrees_with_the_logs(made: Path, logs: list[Log], segments: list[Segment]) -> None:
    found = summary(made)
    assert (found["steps"], found["ended"]) == (400, "budget")
    assert found["switches"] == sum(switch.reason == "learned" for log in logs for switch in log.switches)
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


def test_the_same_again_is_the_same_bytes(made: Path, tmp_path: Path) -> None:
    assert artefacts.digest(collect(TINY, tmp_path / "elsewhere" / "again").path) == artefacts.digest(made)


def test_another_seed_is_another_log(made: Path, tmp_path: Path) -> None:
    other = collect(msgspec.structs.replace(TINY, seed=4, steps=64), tmp_path / "log").path
    assert set(artefacts.lineage(other).facts["puzzles"]).isdisjoint(artefacts.lineage(made).facts["puzzles"])


def test_an_endless_threshold_ends_it_when_all_is_learned(tmp_path: Path) -> None:
    """Everything counts as learned, so every world is looked at for one rollout and then there is none left."""
    config = msgspec.structs.replace(TINY, threshold=1e6)
    log = collect(config, tmp_path / "log").path
    found = summary(log)
    assert found["ended"] == "exhausted"
    assert [row["visits"] for row in found["worlds"]] == [1, 1, 1, 1]
    assert found["steps"] == 4 * 8
    assert [switch.reason for switch in open_log(log_files(log)[0]).switches] == ["start", "learned", "exhausted"]


def test_random_play_is_logged_too(tmp_path: Path) -> None:
    log = collect(msgspec.structs.replace(TINY, explorer="curl+random", steps=48), tmp_path / "log").path
    segment = next(open_log(log_files(log)[0]).segments())
    assert not segment.intrinsic_reward.any()
    np.testing.assert_allclose(segment.policy_entropy, np.log(9), rtol=1e-6)


def test_more_streams_than_worlds_or_steps_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="key `streams`: at most one a world, got 5 for a pool of 4"):
        collect(msgspec.structs.replace(TINY, streams=5), tmp_path / "log")
    with pytest.raises(ConfigError, match="key `steps`: at least one a stream, got 1 for 2 streams"):
        collect(msgspec.structs.replace(TINY, steps=1), tmp_path / "log")
    assert list(tmp_path.iterdir()) == []


def test_the_pool_is_of_different_worlds_and_holds_no_test_puzzle() -> None:
    puzzles = sample_pool(30, SandboxConfig(), seed=1)
    digests = {puzzle.digest for puzzle in puzzles}
    assert len(digests) == 30
    assert digests.isdisjoint(reserved_digests())
    assert sample_pool(30, SandboxConfig(), seed=1) == puzzles


def test_the_loss_of_a_world_is_the_world_models_on_what_was_seen_of_it() -> None:
    pool = Pool(sample_pool(2, SandboxConfig(), seed=1), probe=8, seed=0)
    explorer = Explorer("curl+ride", TINY.encoder, TINY.curl, TINY.ppo, n_actions=9, n_streams=1, seed=0)
    rng = np.random.default_rng(0)
    pictures = rng.integers(0, 256, (8, 84, 84, 3), dtype=np.uint8)
    pool.see(0, pictures)
    draws = [REAL_LOSS(pool, 0, explorer, rollout) for rollout in (1, 1, 2)]
    shifts = torch.Generator().manual_seed(seeding.integer(0, "collect", "probe", 0, 1))
    assert draws[0] == draws[1] == explorer.world_loss(torch.from_numpy(pictures), shifts) != draws[2]
    assert REAL_LOSS(pool, 1, explorer, 1) == math.inf


def test_a_pool_keeps_the_latest_distinct_pictures() -> None:
    pool = Pool(sample_pool(1, SandboxConfig(), seed=1), probe=3, seed=0)
    pictures = [np.full((84, 84, 3), value, np.uint8) for value in (1, 2, 3, 4, 2)]
    pool.see(0, pictures)
    assert pool.tensors()["seen/0"][:, 0, 0, 0].tolist() == [3, 4, 2]


SCRIPT = f"""
import math, sys
from pathlib import Path
import msgspec
from gym_open import seeding
from gym_open.agents.explorer import Explorer
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import collect
from gym_open.collect.pool import Pool
{inspect.getsource(scripted_loss)}
Pool.loss = scripted_loss
collect(msgspec.json.decode(sys.argv[1], type=CollectConfig), Path(sys.argv[2]))
"""


def start(out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", SCRIPT, msgspec.json.encode(TINY).decode(), str(out)]
    return subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"}, stderr=subprocess.DEVNULL)


def kill_after(out: Path, chunks: int) -> None:
    """Start the run and kill it with -9 once its first log holds so many whole chunks."""
    process = start(out)
    log = out.parent / f".{out.name}.partial" / "stream-000.mcap"
    try:
        while not log.is_file() or len(list(whole_chunks(log))) < chunks:
            assert process.poll() is None, "it ended before it could be killed"
            time.sleep(0.01)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


def stop_before(out: Path, rollout: int) -> None:
    """Run in this process until so many rollouts are done, then stop as by Ctrl-C."""
    real = Exploration.rollout

    def rollouts(self: Exploration, length: int) -> Any:
        if self.record.rollouts == rollout:
            raise KeyboardInterrupt
        return real(self, length)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Exploration, "rollout", rollouts)
        with pytest.raises(KeyboardInterrupt):
            collect(TINY, out)


def whole(folder: Path) -> list[list[list[Logged]]]:
    return [list(whole_chunks(path)) for path in log_files(folder)]


def test_killed_and_stopped_it_ends_with_the_same_bytes_and_loses_no_step(made: Path, tmp_path: Path) -> None:
    out, partial = tmp_path / "log", tmp_path / ".log.partial"
    kill_after(out, chunks=7)
    killed = whole(partial)
    assert len(killed[0]) >= 7
    stop_before(out, rollout=19)
    stopped = whole(partial)
    assert len(stopped[0]) >= 19
    assert not out.exists()
    collect(TINY, out)
    assert artefacts.digest(out) == artefacts.digest(made)
    for final, *kept in zip(whole(out), killed, stopped, strict=True):
        assert [final[: len(chunks)] for chunks in kept] == kept


def test_stopped_before_its_first_checkpoint_it_starts_again_and_is_held_to_its_log(made: Path, tmp_path: Path) -> None:
    stop_before(tmp_path / "log", rollout=2)
    assert artefacts.digest(collect(TINY, tmp_path / "log").path) == artefacts.digest(made)


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A run stopped some rollouts after a checkpoint."""
    stop_before(tmp_path / "log", rollout=6)
    return tmp_path / "log"


def test_a_resumed_run_that_diverges_is_refused_and_keeps_the_old_log(
    killed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on another machine, whose arithmetic differs: the policy acts otherwise from the checkpoint on."""
    old = (killed.parent / ".log.partial" / "stream-000.mcap").read_bytes()
    real = Explorer.act
    monkeypatch.setattr(Explorer, "act", lambda self, images: real(self, torch.zeros_like(images)))
    with pytest.raises(LogError, match="not the one that had been logged"):
        collect(TINY, killed)
    assert (killed.parent / ".log.partial" / artefacts.SCRATCH / "stream-000.mcap").read_bytes() == old
    monkeypatch.undo()
    collect(TINY, killed)


def test_a_log_lost_since_the_checkpoint_is_an_error(killed: Path) -> None:
    path = killed.parent / ".log.partial" / "stream-001.mcap"
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(GymOpenError, match=r"stream-001\.mcap: its whole chunks hold"):
        collect(TINY, killed)
