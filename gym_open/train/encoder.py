"""`gym-open train encoder`: CURL learned off-line from a release."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gym_open import artefacts, progress, seeding
from gym_open.agents.curl import Curl, contrastive_accuracy, info_nce
from gym_open.agents.encoder import Encoder, autocast
from gym_open.errors import ArtefactError
from gym_open.formats.checkpoints import (
    load_checkpoint,
    load_optimizer,
    optimizer_tensors,
    prefixed,
    save_checkpoint,
    without_prefix,
)
from gym_open.formats.models import save_encoder
from gym_open.formats.releases import Release, open_release
from gym_open.formats.windows import Pictures
from gym_open.train.config import EncoderTrainConfig
from gym_open.train.curve import Row, clean, save_curve

COLUMNS = ("update", "loss", "accuracy", "held_out_loss", "held_out_accuracy")
"""Of curve.json: means over the updates since the row before, and over fixed batches of the release's split `val`
(worlds that are not in `train`); null if there is none."""

HELD_OUT_BATCHES = 4
MEAN_IMAGES = 10_000
"""At most so many frames make the mean picture."""


def train_encoder(config: EncoderTrainConfig, release: Path, out: Path) -> artefacts.Outcome:
    """Learn an encoder from the pictures of `release`.

    It learns from the release's split `train`; `val` is only looked at.
    Payload: `model.safetensors` and `model.json` (the query encoder with its mean picture) and `curve.json`.
    Killed, it goes on from the last row of its curve.

    Args:
        config: network, loss, length, seed.
        release: a release artefact.
        out: folder of the encoder.

    Raises:
        ArtefactError: if the release is damaged or has too few frames for one batch.
    """

    def work(partial: Path) -> Mapping[str, Any]:
        torch.set_num_threads(config.threads)
        source = open_release(release)
        trainer = _Trainer(config, source, partial / artefacts.SCRATCH / "state.safetensors")
        trainer.resume()
        trainer.run()
        save_encoder(partial, trainer.curl.encoder)
        save_curve(partial, COLUMNS, trainer.rows)
        return {"updates": config.updates, "frames": len(trainer.train_frames)}

    return artefacts.build(out, kind="encoder", config=config, parents=[release], work=work)


class _Trainer:
    """The state of one run: everything that a checkpoint holds."""

    def __init__(self, config: EncoderTrainConfig, release: Release, checkpoint: Path) -> None:
        self.config = config
        self.checkpoint = checkpoint
        self.train_frames, self.held_out_frames = release.split("train"), release.split("val")
        if len(self.train_frames) < config.batch_size:
            raise ArtefactError(
                f"{release.root}: split 'train' has {len(self.train_frames)} frames, expected at least batch_size = "
                f"{config.batch_size}; collect more steps or make batch_size smaller"
            )
        self._decoded = Pictures(release, cache=checkpoint.parent)  # a resumed run finds it there
        init = torch.Generator().manual_seed(seeding.integer(config.seed, "encoder", "init"))
        encoder = Encoder(config.encoder, init)
        spread = np.linspace(0, len(self.train_frames) - 1, min(len(self.train_frames), MEAN_IMAGES)).astype(np.int64)
        encoder.set_mean_image(self.pictures(self.train_frames[spread]))
        self.curl = Curl(encoder, config.curl, init)
        parameters = [parameter for parameter in self.curl.parameters() if parameter.requires_grad]
        self.optimizer = torch.optim.Adam(parameters, lr=config.learning_rate)
        self.batches = seeding.generator(config.seed, "encoder", "batches")
        self.shifts = torch.Generator().manual_seed(seeding.integer(config.seed, "encoder", "shifts"))
        self.rows: list[Row] = []
        self.update = 0

    def run(self) -> None:
        """Train to the last update, a checkpoint with every row of the curve."""
        config, sums = self.config, np.zeros(2)
        with progress.bar("train encoder", config.updates, done=self.update) as bar:
            while self.update < config.updates:
                sums += self.step()
                bar.advance()
                if self.update % config.report_every and self.update < config.updates:
                    continue
                since = self.update - int(self.rows[-1][0] or 0) if self.rows else self.update
                loss, accuracy = (sums / since).tolist()
                self.rows.append(clean([self.update, loss, accuracy, *self.held_out()]))
                sums[:] = 0
                self.save()
                bar.advance(0, note=f"loss {loss:.3f} accuracy {accuracy:.3f}")

    def pictures(self, frames: np.ndarray) -> torch.Tensor:
        """Pictures of the release by frame number: (n, 84, 84, 3) uint8."""
        return torch.from_numpy(self._decoded.take(frames))

    def step(self) -> tuple[float, float]:
        """One gradient step; its loss and contrastive accuracy."""
        frames = self.batches.choice(self.train_frames, size=self.config.batch_size, replace=False)
        with autocast(self.config.precision):
            logits = self.curl.logits(self.pictures(frames), self.shifts)
        loss = info_nce(logits)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.update += 1
        self.curl.stepped()
        return loss.item(), contrastive_accuracy(logits).item()

    @torch.no_grad()
    def held_out(self) -> tuple[float, float]:
        """Mean loss and accuracy on the same batches of split `val` each time; not a number if it is empty."""
        size = min(self.config.batch_size, len(self.held_out_frames))
        if not size:
            return float("nan"), float("nan")
        rng = seeding.generator(self.config.seed, "encoder", "held-out batches")
        shifts = torch.Generator().manual_seed(seeding.integer(self.config.seed, "encoder", "held-out shifts"))
        found = []
        for _ in range(HELD_OUT_BATCHES):
            frames = rng.choice(self.held_out_frames, size=size, replace=False)
            with autocast(self.config.precision):
                logits = self.curl.logits(self.pictures(frames), shifts)
            found.append((info_nce(logits).item(), contrastive_accuracy(logits).item()))
        loss, accuracy = np.mean(found, axis=0).tolist()
        return loss, accuracy

    def save(self) -> None:
        """Write the checkpoint."""
        tensors = {
            **prefixed("curl", self.curl.state_dict()),
            **prefixed("optimizer", optimizer_tensors(self.optimizer)),
            "shifts": self.shifts.get_state(),
        }
        meta = {"update": self.update, "rows": self.rows, "batches": self.batches.bit_generator.state}
        save_checkpoint(self.checkpoint, tensors, meta)

    def resume(self) -> None:
        """Go on from the checkpoint if there is one."""
        if not self.checkpoint.exists():
            return
        tensors, meta = load_checkpoint(self.checkpoint)
        self.curl.load_state_dict(without_prefix("curl", tensors))
        load_optimizer(self.optimizer, without_prefix("optimizer", tensors))
        self.shifts.set_state(tensors["shifts"])
        self.batches.bit_generator.state = meta["batches"]
        self.update, self.rows = meta["update"], meta["rows"]
