"""`gym-open train policy`: PPO on one task, from scratch or from an encoder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gym_open import artefacts, progress, seeding
from gym_open.agents.encoder import IMAGE_SHAPE, Encoder, autocast
from gym_open.agents.policy import ActorCritic
from gym_open.agents.ppo import PPOStats, Rollout, ppo_update
from gym_open.config import to_dict
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.errors import ArtefactError
from gym_open.formats.checkpoints import (
    load_checkpoint,
    load_optimizer,
    optimizer_tensors,
    prefixed,
    save_checkpoint,
    without_prefix,
)
from gym_open.formats.models import (
    ARCHITECTURE,
    EncoderArchitecture,
    load_encoder,
    read_architecture,
    save_policy,
)
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.curve import Row, clean, save_curve
from gym_open.train.tables import Episode, Tables

COLUMNS = (
    "step", "episodes", "mean_return", "success", "mean_length", "entropy", "approx_kl", "clip_fraction",
    "explained_variance", "policy_loss", "value_loss", "learning_rate",
)  # fmt: skip
"""Of curve.json, a row an update: means over the episodes that ended in its rollout (null if none did), then PPO's."""


def train_policy(config: PolicyTrainConfig, encoder: Path | None, out: Path) -> artefacts.Outcome:
    """Train a policy with PPO on puzzles drawn from the training distribution of `config.task`.

    Payload: `model.safetensors` and `model.json` (encoder, policy head, value head) and `curve.json`.
    Killed, it goes on from the last finished update.

    Args:
        config: task, length, learner, seed.
        encoder: an encoder artefact to start from, or None to start from scratch.
        out: folder of the policy.

    Raises:
        ArtefactError: if the encoder is damaged, or is another network than `config.encoder`; nothing was started then.
    """
    if encoder is not None:
        check_architecture(config, encoder)

    def work(partial: Path) -> Mapping[str, Any]:
        torch.set_num_threads(config.threads)
        trainer = _Trainer(config, encoder, partial / artefacts.SCRATCH / "state.safetensors")
        trainer.resume()
        trainer.run()
        save_policy(partial, trainer.agent)
        save_curve(partial, COLUMNS, trainer.rows)
        return {"task": config.task, "steps": trainer.step, "from_encoder": encoder is not None}

    parents = [] if encoder is None else [encoder]
    return artefacts.build(out, kind="policy", config=config, parents=parents, work=work)


def check_architecture(config: PolicyTrainConfig, encoder: Path) -> None:
    """Raise ArtefactError unless the artefact `encoder` is the network that the configuration asks for."""
    artefacts.verify(encoder, "encoder")
    found = to_dict(read_architecture(encoder, EncoderArchitecture).encoder)
    for name, expected in to_dict(config.encoder).items():
        if found[name] != expected:
            raise ArtefactError(
                f"{encoder / ARCHITECTURE}: `encoder.{name}` is {found[name]}, but the policy's configuration says "
                f"{expected}; set `encoder.{name}` to match, or give another encoder"
            )
    load_encoder(encoder)  # every tensor has the shape that its architecture says


def first_pictures(config: PolicyTrainConfig) -> torch.Tensor:
    """Pictures of `config.mean_images` fresh training puzzles, (n, 84, 84, 3) uint8."""
    env = OpenEnv(config.task)
    seed = seeding.integer(config.seed, "policy", "mean picture")
    pictures = [env.reset(seed=seed if i == 0 else None)[0] for i in range(config.mean_images)]
    return torch.from_numpy(np.stack(pictures))


class _Trainer:
    """The state of one run: everything that a checkpoint holds."""

    def __init__(self, config: PolicyTrainConfig, encoder: Path | None, checkpoint: Path) -> None:
        self.config = config
        self.checkpoint = checkpoint
        self.agent = ActorCritic(self._encoder(encoder), N_ACTIONS, self._torch_generator("heads"))
        self.optimizer = torch.optim.Adam(self.agent.parameters(), lr=config.ppo.learning_rate, eps=1e-5)
        self.acting, self.updating = self._torch_generator("actions"), self._torch_generator("update")
        self.tables = Tables(config.task, config.num_envs, config.seed)
        self.rows: list[Row] = []
        self.batch_size = config.num_envs * config.num_steps
        self.num_updates = -(-config.steps // self.batch_size)

    def _torch_generator(self, name: str) -> torch.Generator:
        return torch.Generator().manual_seed(seeding.integer(self.config.seed, "policy", name))

    def _encoder(self, artefact: Path | None) -> Encoder:
        if artefact is not None:
            return load_encoder(artefact)
        encoder = Encoder(self.config.encoder, self._torch_generator("encoder"))
        encoder.set_mean_image(first_pictures(self.config))
        return encoder

    @property
    def step(self) -> int:
        """Agent steps so far, over all environments."""
        return len(self.rows) * self.batch_size

    def run(self) -> None:
        """Train to the last update, with a checkpoint after each."""
        ppo = self.config.ppo
        with progress.bar("train policy", self.num_updates * self.batch_size, done=self.step) as bar:
            while len(self.rows) < self.num_updates:
                frac = 1.0 - len(self.rows) / self.num_updates if ppo.anneal_lr else 1.0
                self.optimizer.param_groups[0]["lr"] = frac * ppo.learning_rate
                rollout, episodes = self.collect(bar)
                stats = ppo_update(self.agent, self.optimizer, rollout, ppo, self.updating)
                self.rows.append(self.row(episodes, stats))
                self.save()
                bar.advance(0, note=f"return {_mean([e.total for e in episodes]):.2f} entropy {stats.entropy:.2f}")

    @torch.no_grad()
    def collect(self, bar: progress.Bar) -> tuple[Rollout, list[Episode]]:
        """Act for `num_steps` in every environment."""
        config, agent, tables = self.config, self.agent, self.tables
        rollout = Rollout.empty(config.num_steps, config.num_envs, IMAGE_SHAPE)
        last_images: dict[tuple[int, int], np.ndarray] = {}
        episodes: list[Episode] = []
        with autocast(config.ppo.precision):
            for t in range(config.num_steps):
                rollout.obs[t] = torch.from_numpy(tables.images)
                action, logprob, _, value = agent.get_action_and_value(
                    agent.encoder.prepare(rollout.obs[t]), generator=self.acting
                )
                rollout.actions[t], rollout.logprobs[t], rollout.values[t] = action, logprob, value
                after = tables.step(action.numpy())
                rollout.rewards[t] = torch.from_numpy(after.rewards)
                rollout.terminations[t] = torch.from_numpy(after.terminations)
                rollout.truncations[t] = torch.from_numpy(after.truncations)
                last_images.update({(t, env): image for env, image in after.last_images.items()})
                episodes += after.episodes
                bar.advance(config.num_envs)
            rollout.next_values[:-1] = rollout.values[1:]
            rollout.next_values[-1] = self._values(tables.images)
            if last_images:  # a truncated episode is worth what its own last picture promises
                times, envs = (list(index) for index in zip(*last_images, strict=True))
                rollout.next_values[times, envs] = self._values(np.stack(list(last_images.values())))
        return rollout, episodes

    def _values(self, images: np.ndarray) -> torch.Tensor:
        return self.agent.get_value(self.agent.encoder.prepare(torch.from_numpy(images)))

    def row(self, episodes: list[Episode], stats: PPOStats) -> Row:
        """The row of curve.json for the update that was just made."""
        return clean(
            [
                self.step + self.batch_size, len(episodes), _mean([e.total for e in episodes]),
                _mean([float(e.success) for e in episodes]), _mean([float(e.length) for e in episodes]),
                stats.entropy, stats.approx_kl, stats.clip_fraction, stats.explained_variance,
                stats.policy_loss, stats.value_loss, self.optimizer.param_groups[0]["lr"],
            ]
        )  # fmt: skip

    def save(self) -> None:
        """Write the checkpoint."""
        tensors = {
            **prefixed("agent", self.agent.state_dict()),
            **prefixed("optimizer", optimizer_tensors(self.optimizer)),
            "acting": self.acting.get_state(),
            "updating": self.updating.get_state(),
        }
        save_checkpoint(self.checkpoint, tensors, {"rows": self.rows, "tables": self.tables.state()})

    def resume(self) -> None:
        """Go on from the checkpoint if there is one."""
        if not self.checkpoint.exists():
            return
        tensors, meta = load_checkpoint(self.checkpoint)
        self.agent.load_state_dict(without_prefix("agent", tensors))
        load_optimizer(self.optimizer, without_prefix("optimizer", tensors))
        self.acting.set_state(tensors["acting"])
        self.updating.set_state(tensors["updating"])
        self.rows = meta["rows"]
        self.tables.restore(meta["tables"])


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else float("nan")
