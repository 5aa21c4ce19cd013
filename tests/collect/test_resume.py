"""A run that is killed and started again ends with the bytes of an undisturbed run, and loses no step."""

import inspect
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.explorer import Explorer
from gym_open.collect import explore
from gym_open.collect.config import CollectConfig, RuleName
from gym_open.collect.explore import collect
from gym_open.collect.pool import Pool
from gym_open.formats.logs import LogError, log_files
from gym_open.formats.logs.container import LogMessage, whole_chunks
from tests.children import python, started

pytestmark = pytest.mark.usefixtures("scripted")

SCRIPT = """
import math, os, signal, sys, time
from pathlib import Path
from typing import Any
import msgspec
from gym_open import seeding
from gym_open.collect.config import CollectConfig
from gym_open.collect.explore import Exploration, collect
from gym_open.collect.pool import Pool
from gym_open.formats.logs.container import whole_chunks
"""
KILLED = """
log, chunks, real = Path(sys.argv[3]), int(sys.argv[4]), Exploration.rollout
def rollout(self, length):
    if self.record.rollouts == chunks + 2:  # the log's own thread writes the chunks, at least one per rollout
        while len(list(whole_chunks(log))) < chunks:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGKILL)
    real(self, length)
Exploration.rollout = rollout
"""
COLLECT = "collect(msgspec.json.decode(sys.argv[1], type=CollectConfig), Path(sys.argv[2]))"


def script(and_so: str = "") -> str:
    """Python code of a run with the same scripted losses as here."""
    return f"{SCRIPT}{inspect.getsource(Pool.loss)}\nPool.loss = scripted_loss\n{and_so}{COLLECT}"


def words(config: CollectConfig, out: Path) -> tuple[str, str]:
    return msgspec.json.encode(config).decode(), str(out)


def kill_after(config: CollectConfig, out: Path, chunks: int) -> None:
    """Start a run that kills itself with SIGKILL when its first log holds `chunks` whole chunks."""
    log = out.parent / f".{out.name}.partial" / "stream-000-000.mcap"
    done = python(script(KILLED), *words(config, out), log, str(chunks))
    assert done.returncode == -signal.SIGKILL, done.stderr


def whole(folder: Path) -> list[list[list[LogMessage]]]:
    """Whole chunks of each stream."""
    return [[chunk for path in parts for chunk in whole_chunks(path)] for parts in log_files(folder)]


def test_killed_and_stopped_it_ends_with_the_same_bytes_and_loses_no_step(
    tiny: CollectConfig, made: Path, tmp_path: Path, stop_before: Any
) -> None:
    out, partial = tmp_path / "log", tmp_path / ".log.partial"
    kill_after(tiny, out, chunks=7)
    killed = whole(partial)
    assert len(killed[0]) >= 7
    stop_before(tiny, out, rollout=19)
    stopped = whole(partial)
    assert len(stopped[0]) >= 19
    assert not out.exists()
    collect(tiny, out)
    assert artefacts.digest(out) == artefacts.digest(made)
    for final, *kept in zip(whole(out), killed, stopped, strict=True):
        assert [final[: len(chunks)] for chunks in kept] == kept


@pytest.mark.usefixtures("no_figure")
@pytest.mark.parametrize("rule", ["uniform", "progress"])
def test_stopped_anywhere_a_rule_decides_the_same(
    tiny: CollectConfig, tmp_path: Path, stop_before: Any, rule: RuleName
) -> None:
    """Seven rollouts, checkpoints after each second one: before the first, at one, between, after the last."""
    config = msgspec.structs.replace(
        tiny, steps=112, checkpoint_every=2,
        curriculum=msgspec.structs.replace(tiny.curriculum, rule=rule, interval=16),
        explorer=msgspec.structs.replace(tiny.explorer, reward="none"),
    )  # fmt: skip
    whole = collect(config, tmp_path / "whole").path
    for rollout in (1, 2, 5, 6):
        stop_before(config, tmp_path / "log", rollout)
    assert artefacts.digest(collect(config, tmp_path / "log").path) == artefacts.digest(whole)
    assert rule in json.loads((whole / "summary.json").read_text())["reasons"]


@pytest.mark.usefixtures("no_figure")
def test_logs_in_several_files_resume_too(
    tiny: CollectConfig, tmp_path: Path, stop_before: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(explore, "MIB", 2**15)
    log = msgspec.structs.replace(tiny.log, roll_mb=1)
    config = msgspec.structs.replace(tiny, steps=256, log=log)
    whole = collect(config, tmp_path / "whole").path
    assert min(len(parts) for parts in log_files(whole)) >= 3
    for rollout in (5, 11):
        stop_before(config, tmp_path / "log", rollout)
    assert artefacts.digest(collect(config, tmp_path / "log").path) == artefacts.digest(whole)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_killed_again_and_again_at_any_moment(tiny: CollectConfig, tmp_path: Path, seed: int) -> None:
    """Killed with SIGKILL at arbitrary times, each a little later, until the run ends."""
    config = msgspec.structs.replace(tiny, steps=800)
    whole = collect(config, tmp_path / "whole").path
    rng, kills = np.random.default_rng(seed), 0
    while not (tmp_path / "log").exists():
        command = [sys.executable, "-c", script(), *words(config, tmp_path / "log")]
        with started(command, stderr=subprocess.DEVNULL) as process:  # and killed when this context ends
            try:
                assert process.wait(3 + kills / 2 + 2 * rng.random()) == 0
            except subprocess.TimeoutExpired:
                kills += 1
    assert kills >= 1
    assert artefacts.digest(tmp_path / "log") == artefacts.digest(whole)


@pytest.fixture
def stopped(tiny: CollectConfig, tmp_path: Path, stop_before: Any) -> Path:
    """A run stopped some rollouts after a checkpoint."""
    stop_before(tiny, tmp_path / "log", rollout=6)
    return tmp_path / "log"


@pytest.mark.usefixtures("no_figure")
def test_a_resumed_run_that_diverges_is_refused_and_keeps_the_old_log(
    tiny: CollectConfig, stopped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a machine with other arithmetic: the policy acts differently from the checkpoint on."""
    old = (stopped.parent / ".log.partial" / "stream-000-000.mcap").read_bytes()
    real = Explorer.act
    monkeypatch.setattr(Explorer, "act", lambda self, images: real(self, torch.zeros_like(images)))
    with pytest.raises(LogError, match="differs from the one logged"):
        collect(tiny, stopped)
    assert (stopped.parent / ".log.partial" / artefacts.SCRATCH / "stream-000-000.mcap").read_bytes() == old
    monkeypatch.undo()
    collect(tiny, stopped)


def test_a_log_lost_since_the_checkpoint_is_an_error(tiny: CollectConfig, stopped: Path) -> None:
    path = stopped.parent / ".log.partial" / "stream-001-000.mcap"
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(LogError, match=r"the whole chunks of stream 1's log hold \d+ messages"):
        collect(tiny, stopped)
