"""Exploration without a task: streams play side by side in a pool of worlds, one learner learns, every step is logged.

repeat: every stream plays a rollout → reward from within → update of policy and world model → loss of each world
        that was played in → log → the curriculum moves streams whose world is learned → now and then a checkpoint
"""

import math
from collections.abc import Mapping
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gym_open import artefacts, progress
from gym_open.agents.explorer import Acted, Explorer, UpdateStats
from gym_open.agents.ppo import Rollout
from gym_open.collect import checkpoint
from gym_open.collect.config import CollectConfig
from gym_open.collect.curriculum import decide, smoothed
from gym_open.collect.pool import Pool, sample_pool
from gym_open.collect.stream import Figures, Played, Stream
from gym_open.collect.summary import Record, SegmentRecord, summarise
from gym_open.config import to_dict
from gym_open.envs.constants import IMAGE_SIZE, N_ACTIONS
from gym_open.envs.physics.model import model_xml
from gym_open.errors import ConfigError
from gym_open.formats.log_schemas import Reason
from gym_open.formats.logs import LogHead, LogWriter, Switch

IMAGE_SHAPE = (IMAGE_SIZE, IMAGE_SIZE, 3)


def collect(config: CollectConfig, out: Path) -> artefacts.Outcome:
    """Explore and log: the artefact `out` of kind `log`, with a file a stream and `summary.json`.

    Killed and run again, it goes on from its last checkpoint and ends with the same bytes.

    Raises:
        ConfigError: if there are more streams than worlds or steps.
        LogError: if a resumed run does not repeat the steps that had been logged after its checkpoint.
    """
    if config.streams > config.pool:
        raise ConfigError(f"key `streams`: at most one a world, got {config.streams} for a pool of {config.pool}")
    if config.streams > config.steps:
        raise ConfigError(f"key `steps`: at least one a stream, got {config.steps} for {config.streams} streams")
    return artefacts.build(out, kind="log", config=config, parents=[], work=lambda folder: _work(config, folder))


def _work(config: CollectConfig, folder: Path) -> Mapping[str, Any]:
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads)
    try:
        with ExitStack() as logs:
            exploration = Exploration(config, folder, logs)
            exploration.run()
    finally:
        torch.set_num_threads(threads)
    return {
        "task": "sandbox",
        "extrinsic_reward": False,
        "puzzles": sorted(puzzle.digest for puzzle in exploration.pool.puzzles),
        "steps": exploration.record.steps,
    }


class Exploration:
    """One run: explorer, pool, streams, and the record of what happened."""

    def __init__(self, config: CollectConfig, folder: Path, open_logs: ExitStack) -> None:
        self.config, self.folder = config, folder
        self.pool = Pool(sample_pool(config.pool, config.sandbox, config.seed), config.probe, config.seed)
        self.explorer = Explorer(
            config.explorer, config.encoder, config.curl, config.ppo,
            n_actions=N_ACTIONS, n_streams=config.streams, seed=config.seed,
        )  # fmt: skip
        self.record = Record()
        logs = [folder / f"stream-{index:03d}.mcap" for index in range(config.streams)]
        killed = [checkpoint.set_aside(log, folder / artefacts.SCRATCH) for log in logs]
        heads = [self._head(index) for index in range(config.streams)]
        self.streams = [
            Stream(index, self.pool, open_logs.enter_context(LogWriter(log, head)))
            for index, (log, head) in enumerate(zip(logs, heads, strict=True))
        ]
        saved = folder / artefacts.SCRATCH / checkpoint.NAME
        messages = checkpoint.load(saved, self) if saved.is_file() else [0] * config.streams
        for stream, old, count in zip(self.streams, killed, messages, strict=True):
            if old is not None:
                stream.log.resume(old, count)
        if not saved.is_file():
            self._start()

    def _head(self, stream: int) -> LogHead:
        packages = {name: metadata.version(name) for name in ("mcap", "mujoco", "numba", "numpy", "torch")}
        provenance = {"code": artefacts.code_version(), "seed": str(self.config.seed), **packages}
        return LogHead(stream, to_dict(self.config), self.pool.puzzles, provenance, model_xml())

    def _start(self) -> None:
        """Put each stream into a world of its own. What the encoder subtracts is the mean first look at the worlds."""
        unknown = [math.inf] * self.config.pool
        for world, stream in enumerate(self.streams):
            stream.switch(Switch(0, -1, world, "start", unknown))
        self.explorer.encoder.set_mean_image(torch.from_numpy(self.pool.first_looks()))

    def run(self) -> None:
        """Play until the budget is spent or every world is learned, then write the summary."""
        config, record = self.config, self.record
        with progress.bar("exploring", config.steps, done=record.steps) as bar:
            while record.ended is None:
                length = min(config.rollout, self._steps_left())
                stats = self.rollout(length)
                if self._steps_left():
                    self._switch()
                else:
                    self._end("budget", self._all_losses())
                note = f"world-model loss {stats.world_model_loss:.2f}, {record.switches} switches"
                bar.advance(length * config.streams, note)
                if record.rollouts % config.checkpoint_every == 0 and record.ended is None:
                    checkpoint.save(self.folder / artefacts.SCRATCH / checkpoint.NAME, self)
        summary = summarise(record, self.pool.puzzles, self.pool.visits)
        artefacts.write_atomically(self.folder / "summary.json", artefacts.canonical_json(summary))

    def _steps_left(self) -> int:
        """Steps that the budget still holds for each stream."""
        return (self.config.steps - self.record.steps) // self.config.streams

    def rollout(self, length: int) -> UpdateStats:
        """Play `length` steps in every stream, learn from them, and log them."""
        images, acted, played = self._play(length)
        latent, values = torch.stack([one.latent for one in acted]), torch.stack([one.values for one in acted])
        nothing = torch.zeros(length, self.config.streams, dtype=torch.bool)
        rollout = Rollout(
            obs=torch.from_numpy(images[:-1]),
            actions=torch.stack([one.actions for one in acted[:-1]]),
            logprobs=torch.stack([one.logprobs for one in acted[:-1]]),
            rewards=self.explorer.intrinsic_reward(latent[:-1], latent[1:]),
            values=values[:-1],
            next_values=values[1:],
            terminations=nothing,
            truncations=nothing,
        )
        stats = self.explorer.update(rollout)
        self.record.rollouts += 1
        self.record.steps += length * self.config.streams
        entropy = torch.stack([one.entropy for one in acted[:-1]])
        losses = self._log(rollout, entropy, played, images)
        reward = float(rollout.rewards.mean())
        self.record.curve.append(
            (self.record.steps, stats.world_model_loss, float(np.mean(losses)), reward, float(entropy.mean()))
        )
        return stats

    def _play(self, length: int) -> tuple[np.ndarray, list[Acted], list[list[Played]]]:
        """Act in all streams side by side: images (length + 1, streams, 84, 84, 3), what was thought of each, steps."""
        images = np.empty((length + 1, self.config.streams, *IMAGE_SHAPE), np.uint8)
        for stream in self.streams:
            stream.look(images[0, stream.index])
        acted = [self.explorer.act(torch.from_numpy(images[0]))]
        played: list[list[Played]] = []
        for now in images[1:]:
            actions: list[int] = acted[-1].actions.tolist()
            played.append([one.play(action, now[one.index]) for one, action in zip(self.streams, actions, strict=True)])
            acted.append(self.explorer.act(torch.from_numpy(now)))
        return images, acted, played

    def _log(
        self, rollout: Rollout, entropy: torch.Tensor, played: list[list[Played]], images: np.ndarray
    ) -> list[float]:
        """Measure the loss of each world that was played in, and log the steps with it; return the losses."""
        losses: list[float] = []
        for stream in self.streams:
            n, place = stream.index, stream.place
            self.pool.see(place.world, images[:, n])
            loss = self.pool.loss(place.world, self.explorer, self.record.rollouts)
            losses.append(loss)
            place.recent = [*place.recent, loss][-self.config.window :]
            for t in range(len(played)):
                figures = Figures(
                    intrinsic_reward=float(rollout.rewards[t, n]), world_model_loss=loss,
                    policy_entropy=float(entropy[t, n]), value=float(rollout.values[t, n]),
                )  # fmt: skip
                stream.record(played[t][n], figures, images[t + 1, n])
            stream.log.flush()
        return losses

    def _switch(self) -> None:
        """Let the curriculum decide for each stream in turn."""
        threshold = self.config.threshold
        if all(smoothed(stream.place.recent) >= threshold for stream in self.streams):
            return  # spares the losses of the worlds that nobody is in
        losses = self._all_losses()
        for stream in self.streams:
            taken = {other.place.world for other in self.streams if other is not stream}
            decision = decide(losses, stream.place.world, taken, threshold)
            if decision.kind == "exhausted":
                self._end("exhausted", losses)
                return
            if decision.kind == "learned":
                self._go(stream, decision.world, "learned", losses)

    def _all_losses(self) -> list[float]:
        """Loss of every world of the pool, as the curriculum defines it."""
        recent = {stream.place.world: stream.place.recent for stream in self.streams}
        return [
            smoothed(recent[world]) if world in recent else self.pool.loss(world, self.explorer, self.record.rollouts)
            for world in range(self.config.pool)
        ]

    def _go(self, stream: Stream, world: int, reason: Reason, losses: list[float]) -> None:
        place = stream.place
        self.record.segments.append(
            SegmentRecord(
                stream=stream.index, segment=place.segment, world=place.world, steps=place.segment_step,
                loss_at_entry=place.loss_at_entry, loss_at_exit=losses[place.world], ended=reason,
            )
        )  # fmt: skip
        stream.switch(Switch(place.step, place.world, world, reason, losses))

    def _end(self, reason: Reason, losses: list[float]) -> None:
        for stream in self.streams:
            self._go(stream, -1, reason, losses)
        self.record.ended, self.record.final_losses = reason, losses
