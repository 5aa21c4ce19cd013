"""Exploration without a task: streams play side by side in a pool of worlds, one learner learns, every step is logged.

repeat: every stream plays a rollout → reward from within → update of policy and world model → loss of each world
        that was played in → log → the curriculum moves streams → now and then a checkpoint
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
from gym_open.collect.stream import ExplorationStream, PlayedStep, StreamPosition
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
    """Explore and log: the artefact `out` of kind `log`.

    It holds a log a stream, in one or more files, the summary as `summary.json` and `summary.png`, and in `encoder/`
    what the explorer's encoder had become, if it has one. Killed and run again, it goes on from its last checkpoint and
    ends with the same bytes.

    Raises:
        ConfigError: if there are more streams than worlds or steps, or the curriculum's rule looks at losses that the
            explorer does not have.
        DivergedError: if what the learner gives is no longer finite.
        LogError: if a resumed run does not repeat the steps that had been logged after its checkpoint.
    """
    if config.streams > config.pool:
        raise ConfigError(f"key `streams`: at most one a world, got {config.streams} for a pool of {config.pool}")
    if config.streams > config.steps:
        raise ConfigError(f"key `steps`: at least one a stream, got {config.steps} for {config.streams} streams")
    if RULES[config.curriculum.rule].needs_losses and config.explorer.world_model == "none":
        others = ", ".join(name for name, rule in RULES.items() if not rule.needs_losses)
        raise ConfigError(
            f"key `curriculum.rule`: {config.curriculum.rule} looks at the loss of a world model, and "
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
    """The configuration with the learner's precision in place of `auto`, as logs hold it, and that precision.

    An explorer without a learner has None, and keeps its configuration: its log is the same on every processor.
    """
    explorer = config.explorer
    if explorer.world_model == "none":
        return config, None
    precision = settle(explorer.ppo.precision, "cpu", folder / artefacts.SCRATCH)
    ppo = structs.replace(explorer.ppo, precision=precision)
    return structs.replace(config, explorer=structs.replace(explorer, ppo=ppo)), precision


class Exploration:
    """One run: explorer, pool, streams, curriculum, and the record of what happened."""

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
        """Put each stream into a world of its own. What the encoder subtracts is the mean first look at the worlds."""
        unknown = self._all_losses()
        for world, stream in enumerate(self.streams):
            stream.switch(Switch(0, -1, world, "start", unknown))
        self.explorer.set_mean_image(torch.from_numpy(self.pool.first_looks()))

    def run(self) -> None:
        """Play until the budget is spent or every world is learned."""
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
        """Write the summary, and what the encoder has become."""
        summary = summarise(self.config, self.record, self.pool.puzzles, self.pool.tallies)
        write_atomically(self.folder / "summary.json", artefacts.canonical_json(summary))
        write_atomically(self.folder / "summary.png", draw_summary(summary, self.config.curriculum))
        if self.explorer.encoder is not None:
            save_encoder(self.folder / "encoder", self.explorer.encoder)

    def _note(self) -> str:
        seen = sum(tally.visits > 0 for tally in self.pool.tallies)
        loss = f"loss of the worlds {self.record.curve[-1][2]:.2g}, " if self.explorer.learns else ""
        return f"{loss}{seen} of {self.config.pool} worlds, {self.record.switches} switches"

    def _steps_left(self) -> int:
        """Steps that the budget still holds for each stream."""
        return (self.config.steps - self.record.steps) // self.config.streams

    def rollout(self, length: int) -> None:
        """Play `length` steps in every stream, learn from them, and log them."""
        images, acted, played = self._play(length)
        self.record.rollouts += 1
        self.record.steps += length * self.config.streams
        learned = self.explorer.learn(torch.from_numpy(images), acted)
        losses = [self._world_loss(stream, images[:, stream.index], played) for stream in self.streams]
        self._log(acted, played, learned, losses)
        entropy = float(torch.stack([one.entropy for one in acted[:-1]]).mean())
        scale = self.explorer.model.loss_scale if self.explorer.model else math.nan
        self.record.curve.append(
            (
                self.record.steps, scale * learned.stats.world_model_loss, float(np.mean(losses)),
                float(learned.reward.mean()), entropy,
            )
        )  # fmt: skip

    def _play(self, length: int) -> tuple[np.ndarray, list[Acted], list[list[PlayedStep]]]:
        """Act in all streams side by side: images (length + 1, streams, 84, 84, 3), what was thought of each, steps."""
        images = np.empty((length + 1, self.config.streams, *IMAGE_SHAPE), np.uint8)
        for stream in self.streams:
            stream.look(images[0, stream.index])
        acted = [self.explorer.act(torch.from_numpy(images[0]))]
        played: list[list[PlayedStep]] = []
        for now in images[1:]:
            actions: list[int] = acted[-1].actions.tolist()
            played.append([one.play(action, now[one.index]) for one, action in zip(self.streams, actions, strict=True)])
            acted.append(self.explorer.act(torch.from_numpy(now)))
        return images, acted, played

    def _world_loss(self, stream: ExplorationStream, images: np.ndarray, played: list[list[PlayedStep]]) -> float:
        """Measure the loss of the world that a stream is in, after what was played there; not a number for no model."""
        place = stream.place
        if not self.explorer.learns:
            return math.nan
        actions = np.array([now[stream.index].step.action for now in played], dtype=np.int64)
        self.pool.see(place.world, images[:-1], actions, images[1:])
        loss = self.pool.loss(place.world, self.explorer, self.record.rollouts)
        place.recent = [*place.recent, loss][-self.config.curriculum.window :]
        return loss

    def _log(
        self, acted: list[Acted], played: list[list[PlayedStep]], learned: LearnedRollout, losses: list[float]
    ) -> None:
        rewards, parts = learned.reward.tolist(), learned.parts.tolist()
        entropy, values = [one.entropy.tolist() for one in acted], [one.values.tolist() for one in acted]
        for stream, loss in zip(self.streams, losses, strict=True):
            n = stream.index
            for t in range(len(played)):
                metrics = StepMetrics(rewards[t][n], loss, entropy[t][n], values[t][n], tuple(parts[t][n]))
                stream.record(played[t][n], metrics)
            stream.log.flush()

    def _decide(self) -> None:
        """Let the curriculum decide for each stream in turn."""
        due = [stream for stream in self.streams if self._due(stream.place)]
        if not due:
            return  # spares the losses of the worlds that nobody is in
        record, losses = self.record, self._all_losses()
        before = record.last_losses or [math.inf] * self.config.pool
        for stream in due:
            current = stream.place.world
            taken = {other.place.world for other in self.streams if other is not stream}
            decision = self.rule.decide(Situation(losses, before, current, taken, record.decisions))
            record.decisions += 1
            if decision.kind == "exhausted":
                self._end("exhausted", losses)
                return
            if decision.kind == "stay":
                stream.place.decided = stream.place.segment_step
            else:
                self._go(stream, decision.world, decision.kind, losses)
        record.last_losses = losses

    def _due(self, place: StreamPosition) -> bool:
        """Whether the curriculum has something to decide for the stream that is there."""
        measured = len(place.recent) == self.config.curriculum.window
        loss = smoothed(place.recent) if measured else math.inf  # one low figure is no mean of several
        return self.rule.due(loss, place.segment_step - place.decided)

    def _all_losses(self) -> list[float]:
        """Loss of every world of the pool, as the curriculum defines it."""
        if not self.explorer.learns:
            return [math.nan] * self.config.pool
        recent = {stream.place.world: stream.place.recent for stream in self.streams}
        return [
            smoothed(recent[world]) if world in recent else self.pool.loss(world, self.explorer, self.record.rollouts)
            for world in range(self.config.pool)
        ]

    def _go(self, stream: ExplorationStream, world: int, reason: Ended, losses: list[float]) -> None:
        place = stream.place
        self.record.segments.append(
            SegmentRecord(
                stream=stream.index, segment=place.segment, world=place.world, steps=place.segment_step,
                loss_at_entry=place.loss_at_entry, loss_at_exit=losses[place.world], ended=reason,
            )
        )  # fmt: skip
        stream.switch(Switch(place.step, place.world, world, reason, losses))
        self.explorer.entered(stream.index)

    def _end(self, reason: Ended, losses: list[float]) -> None:
        for stream in self.streams:
            self._go(stream, -1, reason, losses)
        self.record.ended, self.record.final_losses = reason, losses
