"""`gym-open train encoder`: learn a world model off-line from a release, and keep its encoder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from msgspec import structs

from gym_open import artefacts, progress, seeding
from gym_open.agents.architectures import make_image_encoder
from gym_open.agents.augment import draw_shifts
from gym_open.agents.encoder import autocast
from gym_open.agents.threads import set_threads
from gym_open.agents.world_model import TransitionBatch
from gym_open.agents.world_models import make_world_model
from gym_open.envs.constants import N_ACTIONS
from gym_open.errors import ArtefactError, DivergedError
from gym_open.formats.checkpoints import (
    load_optimizer,
    load_resumable,
    optimizer_tensors,
    prefixed,
    save_resumable,
    without_prefix,
)
from gym_open.formats.models import save_encoder
from gym_open.formats.releases import IMAGE
from gym_open.formats.windows import Batch, Pictures, Windows
from gym_open.hardware import check_device, hardware
from gym_open.precision import settle
from gym_open.replay.compact import open_dataset
from gym_open.train.config import EncoderTrainConfig
from gym_open.train.curve import Board, Row, clean, save_curve

HELD_OUT_BATCHES = 4
FIRST_IMAGES = 10_000
"""Largest number of frames, spread over the release, for the mean image and the first running statistics."""


def train_encoder(
    config: EncoderTrainConfig, release: Path, out: Path, *, tensorboard: Path | None = None, cache: Path | None = None
) -> artefacts.Outcome:
    """Learn an encoder from the exploration in `release`.

    It learns from the split `train` of the release and is only measured on `val`. A killed run continues from the last
    row of its curve. Payload: `model.safetensors` and `model.json` (the encoder with its mean image) and `curve.json`.
    The columns of the curve are `update`; the world model's `loss` and figures, as means over the updates since the row
    before; and the same with `held_out_`, over fixed batches of the split `val` (worlds that are not in `train`; null
    if there is none). CURL's held-out figures get worse with fewer worlds in `val`, since images of one world are hard
    to tell apart.

    Args:
        config: network, world model, length, seed.
        release: a release artefact.
        out: folder of the encoder.
        tensorboard: folder for event files of the curve. They hold times of day, so they are not in the artefact.
        cache: folder that keeps the decoded images of the release for later runs; by default they are deleted.

    Raises:
        ArtefactError: if the release is damaged or has too few steps for one batch.
        ConfigError: if the configuration asks for a GPU and there is none.
        DivergedError: if the loss is no longer finite.
    """
    check_device(config.device)

    def work(partial: Path) -> Mapping[str, Any]:
        set_threads(config.threads)
        scratch = partial / artefacts.SCRATCH
        precision = settle(config.precision, config.device, scratch)
        pictures = Pictures(open_dataset(release), cache=cache or scratch)  # where a resumed run finds them
        trainer = _EncoderTrainer(structs.replace(config, precision=precision), pictures, scratch / "state.safetensors")
        trainer.resume()
        board = Board(tensorboard)
        trainer.run(board)
        board.close()
        found = trainer.finish()
        save_encoder(partial, trainer.model.encoder)
        save_curve(partial, trainer.columns, trainer.rows)
        return {
            "world_model": config.world_model,
            "updates": config.updates,
            "frames": trainer.frames,
            **found,
            "precision": precision,
            "hardware": hardware(config.threads, config.device),
        }

    return artefacts.build(out, kind="encoder", config=config, parents=[release], work=work)


class _EncoderTrainer:
    """The state of one run, which a checkpoint holds in full."""

    def __init__(self, config: EncoderTrainConfig, pictures: Pictures, checkpoint: Path) -> None:
        self.config, self.checkpoint, self.release = config, checkpoint, pictures.release.root
        self.train, self.held_out = _steps(pictures, "train"), _steps(pictures, "val")
        if self.train is None or len(self.train) < config.batch_size:
            raise ArtefactError(
                f"{pictures.release.root}: split 'train' has {len(self.train or ())} steps, expected at least "
                f"batch_size = {config.batch_size}; collect more steps, or give a smaller batch_size"
            )
        init = self._torch_generator("init")
        encoder = make_image_encoder(config.encoder, init)
        frames = pictures.release.split("train")
        self.frames = len(frames)
        spread = np.linspace(0, len(frames) - 1, min(len(frames), FIRST_IMAGES)).astype(np.int64)
        first = torch.from_numpy(pictures.take(frames[spread]))
        encoder.set_mean_image(first)
        self.model = make_world_model(config.world_model, config, encoder, N_ACTIONS, init)
        self.model.watch(first)
        self.model.to(config.device)
        learned = [parameter for parameter in self.model.parameters() if parameter.requires_grad]
        self.optimizer = torch.optim.Adam(learned, lr=config.learning_rate, fused=True)
        self.shifts = self._torch_generator("shifts")
        self.rows: list[Row] = []

    def _torch_generator(self, name: str) -> torch.Generator:
        return torch.Generator().manual_seed(seeding.integer(self.config.seed, "encoder", name))

    @property
    def columns(self) -> list[str]:
        """Columns of the learning curve."""
        figures = ["loss", *self.model.figures]
        return ["update", *figures, *(f"held_out_{name}" for name in figures)]

    @property
    def update(self) -> int:
        """Number of gradient steps at the last row."""
        return int(self.rows[-1][0] or 0) if self.rows else 0

    def run(self, board: Board) -> None:
        """Train to the last update, with a checkpoint at every row of the curve."""
        config, since = self.config, torch.zeros(())
        assert self.train is not None
        batches = self.train.batches(
            seeding.generator(config.seed, "encoder", "batches"), config.batch_size, skip=self.update
        )
        with progress.bar("train encoder", config.updates, done=self.update) as bar:
            for update in range(self.update + 1, config.updates + 1):
                since = since + self.step(next(batches), update)
                bar.advance()
                if update % config.report_every and update < config.updates:
                    continue
                learned = (since / (update - self.update)).tolist()
                since = torch.zeros(())
                self.rows.append(clean([update, *learned, *self.measure_held_out()]))
                self.save()
                board.row(update, dict(zip(self.columns[1:], self.rows[-1][1:], strict=True)))
                bar.advance(0, note=f"loss {learned[0]:.3g} held out {self.rows[-1][1 + len(learned)] or 0:.3g}")

    def step(self, batch: Batch, update: int) -> torch.Tensor:
        """Take one gradient step; return its loss and figures, (1 + figures,) float64.

        Raises:
            DivergedError: if the loss is not finite.
        """
        loss, figures = self.measure(batch, self.shifts)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.model.stepped()
        if not figures[0].isfinite():
            raise DivergedError(
                f"the loss is not finite in update {update}: learning has diverged; give a lower `learning_rate`, got "
                f"{self.config.learning_rate:g}, or a smaller `encoder.pixel_scale`, got "
                f"{self.config.encoder.pixel_scale:g}"
            )
        return figures

    def measure(self, batch: Batch, shifts: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """The loss of a batch, for gradients, and loss and figures as numbers, (1 + figures,) float64 on the CPU."""
        images, device = torch.from_numpy(batch[IMAGE]).to(self.config.device), self.config.device
        actions = torch.from_numpy(batch["action.index"][:, 0]).to(device)
        drawn = draw_shifts(len(images), self.config.shift_pad, shifts)
        with autocast(self.config.precision, device):
            loss, figures = self.model.measure(TransitionBatch(images[:, 0], actions, images[:, 1]), drawn, shifts)
        return loss, torch.stack([loss.detach(), *figures.values()]).double().cpu()

    def finish(self) -> dict[str, float]:
        """Let the world model learn what needs its finished encoder; return facts about it.

        Raises:
            ArtefactError: if it cannot learn that from this release.
        """
        assert self.train is not None
        spread = np.linspace(0, len(self.train) - 1, min(len(self.train), FIRST_IMAGES)).astype(np.int64)
        batch = self.train.fetch(spread)
        images, actions = torch.from_numpy(batch[IMAGE]), torch.from_numpy(batch["action.index"][:, 0])
        try:
            return self.model.to("cpu").finish(TransitionBatch(images[:, 0], actions, images[:, 1]))
        except ValueError as error:
            raise ArtefactError(
                f"{self.release}: {error}; train longer (`updates`), collect more steps, or give `encoder.frame` image"
            ) from None

    @torch.no_grad()
    def measure_held_out(self) -> list[float]:
        """Mean loss and figures on fixed batches of split `val`; not a number if there is none."""
        if self.held_out is None:
            return [float("nan")] * (1 + len(self.model.figures))
        rng, shifts = (
            seeding.generator(self.config.seed, "encoder", "held-out batches"),
            self._torch_generator("held out"),
        )
        size = min(self.config.batch_size, len(self.held_out))
        draws = [rng.choice(len(self.held_out), size=size, replace=False) for _ in range(HELD_OUT_BATCHES)]
        return torch.stack([self.measure(self.held_out.fetch(one), shifts)[1] for one in draws]).mean(dim=0).tolist()

    def save(self) -> None:
        """Write the checkpoint."""
        tensors = {
            **prefixed("model", self.model.state_dict()),
            **prefixed("optimizer", optimizer_tensors(self.optimizer)),
            "shifts": self.shifts.get_state(),
        }
        save_resumable(self.checkpoint, tensors, {"rows": self.rows})

    def resume(self) -> None:
        """Continue from the checkpoint if there is one."""
        found = load_resumable(self.checkpoint)
        if found is None:
            return
        tensors, meta = found
        self.model.load_state_dict(without_prefix("model", tensors))
        load_optimizer(self.optimizer, without_prefix("optimizer", tensors))
        self.shifts.set_state(tensors["shifts"])
        self.rows = meta["rows"]


def _steps(pictures: Pictures, split: str) -> Windows | None:
    """All steps of a split: pairs of frames with the action between them; None if there is none."""
    episodes = pictures.release.episodes
    if not ((episodes["split"] == split) & (episodes["length"] > 1)).any():
        return None
    return Windows(pictures, split, length=2)
