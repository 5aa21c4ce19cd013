"""Exploration without a task: parallel streams act in a pool of worlds, one learner learns, and every step is logged.

repeat: every stream acts for a rollout → intrinsic reward → update of policy and world model → loss of each current
        world → log → the curriculum moves streams → sometimes a checkpoint
"""

import math
from collections.abc import Mapping
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
from msgspec import structs

from gym_open import artefacts, progress
from gym_open.agents.explorer import Acted, Explorer, LearnedRollout
from gym_open.agents.threads import threads
from gym_open.collect import checkpoint
from gym_open.collect.config import CollectConfig
from gym_open.collect.curriculum import RULES, Situation, smoothed
from gym_open.collect.figure import draw_summary
from gym_open.collect.pool import Pool, sample_pool
from gym_open.collect.stream import ExplorationStream, LoggedStep, StreamPosition
from gym_open.collect.summary import RunRecord, SegmentRecord, summarise
from gym_open.config import to_dict
from gym_open.envs.constants import IMAGE_SIZE, N_ACTIONS
from gym_open.envs.physics.model import model_xml
from gym_open.errors import ConfigError, DivergedError
from gym_open.files import write_atomically
from gym_open.formats.logs import LogHead, LogWriter, StepMetrics, Switch
from gym_open.formats.logs.resume import resume_writer
from gym_open.formats.logs.schemas import Ended
from gym_open.formats.models import save_encoder
from gym_open.precision import Precision, settle

IMAGE_SHAPE = (IMAGE_SIZE, IMAGE_SIZE, 3)
MIB = 2**20


def collect(config: CollectConfig, out: Path) -> artefacts.Outcome:
    """Explore, and write the artefact `out` of kind `log`.

    It holds one log per stream, in one or more files; the summary as `summary.json` and `summary.png`; and in
    `encoder/` the explorer's final encoder, if it has one. A killed run that is started again resumes from
    its last checkpoint and ends with the same bytes.

    Raises:
        ConfigError: if there are more streams than worlds or steps, or if the curriculum's rule needs losses and the
            explorer has no world model.
        DivergedError: if an output of the learner is no longer finite.
        LogError: if a resumed run does not repeat the steps that were logged after its checkpoint.
    """
    if config.streams > config.pool:
        raise ConfigError(f"key `streams`: at most one per world, got {config.streams} for a pool of {config.pool}")
    if config.streams > config.steps:
        raise ConfigError(f"key `steps`: at least one per stream, got {config.steps} for {config.streams} streams")
    if RULES[config.curriculum.rule].needs_losses and config.explorer.world_model == "none":
        others = ", ".join(name for name, rule in RULES.items() if not rule.needs_losses)
        raise ConfigError(
            f"key `curriculum.rule`: {config.curriculum.rule} needs the loss of a world model, and "
            f"`explorer.world_model` is none; give one of {others}, or a world model"
        )
    return artefacts.build(out, kind="log", config=config, parents=[], work=lambda folder: _work(config, folder))


def _work(config: CollectConfig, folder: Path) -> Mapping[str, Any]:
    config, precision = _settled(config, folder)
    with threads(config.threads), ExitStack() as logs:
        with progress.doing("preparing the worlds", progress.COMPILES):
            exploration = Exploration(config, folder, logs)
        try:
            exploration.run()
        except DivergedError as error:
            raise DivergedError(
                f"{error} after {exploration.record.steps} steps: learning has diverged; give a lower "
                f"`explorer.ppo.learning_rate`, got {config.explorer.ppo.learning_rate:g}"
            ) from None
    exploration.finish()
    return {
        "task": "sandbox",
        "extrinsic_reward": False,
        "explorer": config.explorer.name,
        "puzzles": sorted(puzzle.digest for puzzle in exploration.pool.puzzles),
        "steps": exploration.record.steps,
        "precision": precision,
    }


def _settled(config: CollectConfig, folder: Path) -> tuple[CollectConfig, Precision | None]:
    """The configuration for the logs, with the learner's precision in place of `auto`, and this precision.

    Without a learner, the precision is None and the configuration stays: the log is the same on every processor.
    """
    explorer = config.explorer
    if explorer.world_model == "none":
        return config, None
    precision = settle(explorer.ppo.precision, "cpu", folder / artefacts.SCRATCH)
    ppo = structs.replace(explorer.ppo, precision=precision)
    return structs.replace(config, explorer=structs.replace(explorer, ppo=ppo)), precision


class Exploration:
    """One exploration run: explorer, pool, streams, curriculum, and the record of what happened."""

    def __init__(self, config: CollectConfig, folder: Path, open_logs: ExitStack) -> None:
        self.config, self.folder = config, folder
        self.pool = Pool(sample_pool(config.pool, config.sandbox, config.seed), config.probe, config.seed)
        self.explorer = Explorer(config.explorer, n_actions=N_ACTIONS, n_streams=config.streams, seed=config.seed)
        self.rule = RULES[config.curriculum.rule](config.curriculum, config.seed)
        self.record = RunRecord()
        saved = checkpoint.load(folder / artefacts.SCRATCH / checkpoint.NAME)
        messages = saved.messages if saved else [0] * config.streams
        self.streams = [
            ExplorationStream(index, self.pool, open_logs.enter_context(self._writer(index, count)), config.log)
            for index, count in enumerate(messages)
        ]
        if saved:
            self.record = checkpoint.restore(saved, self.explorer, self.pool, self.streams)
        else:
            self._start()

    def _writer(self, stream: int, messages: int) -> LogWriter:
        packages = {name: metadata.version(name) for name in ("mcap", "mujoco", "numba", "numpy", "torch")}
        provenance = {"code": artefacts.code_version("log"), "seed": str(self.config.seed), **packages}
        head = LogHead(
            stream, to_dict(self.config), self.pool.puzzles, provenance, model_xml(),
            reward_parts=self.explorer.reward_parts, keyframe_every=self.config.log.keyframe_every,
        )  # fmt: skip
        roll_bytes = self.config.log.roll_mb * MIB
        return resume_writer(self.folder, self.folder / artefacts.SCRATCH, head, messages, roll_bytes=roll_bytes)

    def _start(self) -> None:
        """Put each stream into a world of its own, and compute the encoder's mean image from all initial images."""
        unknown = self._all_losses()
        for world, stream in enumerate(self.streams):
            stream.switch(Switch(0, -1, world, "start", unknown))
        self.explorer.set_mean_image(torch.from_numpy(self.pool.initial_images()))

    def run(self) -> None:
        """Explore until the budget is spent or every world is learned."""
        config, record = self.config, self.record
        with progress.bar("exploring", config.steps, done=record.steps) as bar:
            while record.ended is None:
                length = min(config.rollout, self._steps_left())
                self.rollout(length)
                if self._steps_left():
                    self._decide()
                else:
                    self._end("budget", self._all_losses())
                bar.advance(length * config.streams, self._note())
                if record.rollouts % config.checkpoint_every == 0 and record.ended is None:
                    path = self.folder / artefacts.SCRATCH / checkpoint.NAME
                    checkpoint.save(path, record, self.explorer, self.pool, self.streams)

    def finish(self) -> None:
        """Write the summary and the final encoder."""
        summary = summarise(self.config, self.record, self.pool.puzzles, self.pool.counts)
        write_atomically(self.folder / "summary.json", artefacts.canonical_json(summary))
        write_atomically(self.folder / "summary.png", draw_summary(summary, self.config.curriculum))
        if self.explorer.encoder is not None:
            save_encoder(self.folder / "encoder", self.explorer.encoder)

    def _note(self) -> str:
        seen = sum(count.visits > 0 for count in self.pool.counts)
        loss = f"loss of the worlds {self.record.curve[-1][2]:.2g}, " if self.explorer.learns else ""
        return f"{loss}{seen} of {self.config.pool} worlds, {self.record.switches} switches"

    def _steps_left(self) -> int:
        """Remaining steps of the budget for each stream."""
        return (self.config.steps - self.record.steps) // self.config.streams

    def rollout(self, length: int) -> None:
        """Take `length` steps in every stream, learn from them, and log them."""
        images, acted, steps = self._act(length)
        self.record.rollouts += 1
        self.record.steps += length * self.config.streams
        learned = self.explorer.learn(torch.from_numpy(images), acted)
        losses = [self._world_loss(stream, images[:, stream.index], steps) for stream in self.streams]
        self._log(acted, steps, learned, losses)
        entropy = float(torch.stack([one.entropy for one in acted[:-1]]).mean())
        scale = self.explorer.model.loss_scale if self.explorer.model else math.nan
        self.record.curve.append(
            (
                self.record.steps, scale * learned.stats.world_model_loss, float(np.mean(losses)),
                float(learned.reward.mean()), entropy,
            )
        )  # fmt: skip

    def _act(self, length: int) -> tuple[np.ndarray, list[Acted], list[list[LoggedStep]]]:
        """Act in all streams: images (length + 1, streams, 84, 84, 3), the output of `act` for each, and the steps."""
        images = np.empty((length + 1, self.config.streams, *IMAGE_SHAPE), np.uint8)
        for stream in self.streams:
            stream.look(images[0, stream.index])
        acted = [self.explorer.act(torch.from_numpy(images[0]))]
        steps: list[list[LoggedStep]] = []
        for now in images[1:]:
            actions: list[int] = acted[-1].actions.tolist()
            steps.append([one.step(action, now[one.index]) for one, action in zip(self.streams, actions, strict=True)])
            acted.append(self.explorer.act(torch.from_numpy(now)))
        return images, acted, steps

    def _world_loss(self, stream: ExplorationStream, images: np.ndarray, steps: list[list[LoggedStep]]) -> float:
        """Measure the loss of the world that a stream is in, after a rollout. NaN without a world model."""
        position = stream.position
        if not self.explorer.learns:
            return math.nan
        actions = np.array([now[stream.index].step.action for now in steps], dtype=np.int64)
        self.pool.see(position.world, images[:-1], actions, images[1:])
        loss = self.pool.loss(position.world, self.explorer, self.record.rollouts)
        position.recent = [*position.recent, loss][-self.config.curriculum.window :]
        return loss

    def _log(
        self, acted: list[Acted], steps: list[list[LoggedStep]], learned: LearnedRollout, losses: list[float]
    ) -> None:
        rewards, parts = learned.reward.tolist(), learned.parts.tolist()
        entropy, values = [one.entropy.tolist() for one in acted], [one.values.tolist() for one in acted]
        for stream, loss in zip(self.streams, losses, strict=True):
            n = stream.index
            for t in range(len(steps)):
                metrics = StepMetrics(rewards[t][n], loss, entropy[t][n], values[t][n], tuple(parts[t][n]))
                stream.record(steps[t][n], metrics)
            stream.log.flush()

    def _decide(self) -> None:
        """Let the curriculum decide for each stream in turn."""
        due = [stream for stream in self.streams if self._due(stream.position)]
        if not due:
            return  # saves computing the losses of the other worlds
        record, losses = self.record, self._all_losses()
        before = record.last_losses or [math.inf] * self.config.pool
        for stream in due:
            current = stream.position.world
            taken = {other.position.world for other in self.streams if other is not stream}
            decision = self.rule.decide(Situation(losses, before, current, taken, record.decisions))
            record.decisions += 1
            if decision.kind == "exhausted":
                self._end("exhausted", losses)
                return
            if decision.kind == "stay":
                stream.position.decided = stream.position.segment_step
            else:
                self._switch(stream, decision.world, decision.kind, losses)
        record.last_losses = losses

    def _due(self, position: StreamPosition) -> bool:
        """Whether the curriculum must decide for the stream at this position."""
        measured = len(position.recent) == self.config.curriculum.window
        loss = smoothed(position.recent) if measured else math.inf  # one low value is no mean of several
        return self.rule.due(loss, position.segment_step - position.decided)

    def _all_losses(self) -> list[float]:
        """Loss of every world of the pool, as the curriculum defines it."""
        if not self.explorer.learns:
            return [math.nan] * self.config.pool
        recent = {stream.position.world: stream.position.recent for stream in self.streams}
        return [
            smoothed(recent[world]) if world in recent else self.pool.loss(world, self.explorer, self.record.rollouts)
            for world in range(self.config.pool)
        ]

    def _switch(self, stream: ExplorationStream, world: int, reason: Ended, losses: list[float]) -> None:
        position = stream.position
        self.record.segments.append(
            SegmentRecord(
                stream=stream.index, segment=position.segment, world=position.world, steps=position.segment_step,
                loss_at_entry=position.loss_at_entry, loss_at_exit=losses[position.world], ended=reason,
            )
        )  # fmt: skip
        stream.switch(Switch(position.step, position.world, world, reason, losses))
        self.explorer.entered(stream.index)

    def _end(self, reason: Ended, losses: list[float]) -> None:
        for stream in self.streams:
            self._switch(stream, -1, reason, losses)
        self.record.ended, self.record.final_losses = reason, losses
