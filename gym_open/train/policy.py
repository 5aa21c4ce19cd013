"""`gym-open train policy`: PPO on one task, from scratch or from an encoder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from msgspec import structs

from gym_open import artefacts, progress, seeding
from gym_open.agents.architectures import make_encoder
from gym_open.agents.config import OBJECT_ENCODERS
from gym_open.agents.encoder import Encoder, ImageEncoder, StateEncoder, autocast
from gym_open.agents.policy import ActorCritic
from gym_open.agents.ppo import PPOStats, Rollout, ppo_update
from gym_open.agents.threads import set_threads
from gym_open.config import to_dict
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.errors import ArtefactError, ConfigError, DivergedError
from gym_open.files import sha256_file
from gym_open.formats.checkpoints import (
    load_optimizer,
    load_resumable,
    optimizer_tensors,
    prefixed,
    save_resumable,
    without_prefix,
)
from gym_open.formats.models import (
    ARCHITECTURE,
    EncoderArchitecture,
    encoder_folder,
    load_encoder,
    policy_folder,
    read_architecture,
    save_policy,
)
from gym_open.hardware import check_device, hardware
from gym_open.precision import settle
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.curve import Board, Row, clean, save_curve
from gym_open.train.environments import FinishedEpisode, TrainingEnvironments
from gym_open.train.transfer import take_over

COLUMNS = (
    "step", "episodes", "mean_return", "success", "mean_length", "entropy", "approx_kl", "clip_fraction",
    "explained_variance", "policy_loss", "value_loss", "learning_rate",
)  # fmt: skip
"""Columns of curve.json, which has one row per update: means over the episodes that ended in the rollout (null if none
did), then PPO's metrics."""


def train_policy(
    config: PolicyTrainConfig, encoder: Path | None, out: Path, *, tensorboard: Path | None = None
) -> artefacts.Outcome:
    """Train a policy with PPO on puzzles drawn from the training distribution of `config.task`.

    Payload: `model.safetensors` and `model.json` (encoder, policy head, value head), `curve.json`, and the policy at
    each of `config.checkpoints`, in `checkpoints/<step>/`. A killed run continues from the last finished update.

    Args:
        config: task, length, learner, seed.
        encoder: the encoder to start from: an encoder artefact, or a log with the encoder of its explorer. None starts
            from scratch.
        out: folder of the policy.
        tensorboard: folder for TensorBoard's event files, which do not belong to the artefact.

    Raises:
        ArtefactError: if the encoder is damaged, or its network is not `config.encoder`. Nothing was started then.
        ConfigError: if the configuration asks for a frozen encoder or a GPU, and there is none.
        DivergedError: if the loss is no longer finite.
    """
    check_device(config.device)
    if encoder is not None:
        check_architecture(config, encoder)
    elif config.frozen:
        raise ConfigError("frozen: true, but there is no encoder to keep unchanged; give --encoder, or false")

    def work(partial: Path) -> Mapping[str, Any]:
        set_threads(config.threads)
        precision = settle(config.ppo.precision, config.device, partial / artefacts.SCRATCH)
        settled = structs.replace(config, ppo=structs.replace(config.ppo, precision=precision))
        with progress.doing("preparing the puzzles", progress.COMPILES):
            trainer = _PolicyTrainer(settled, encoder, partial)
        trainer.resume()
        trainer.run(tensorboard)
        save_policy(partial, trainer.agent)
        save_curve(partial, COLUMNS, trainer.rows)
        return _facts(settled, encoder, trainer)

    parents = [] if encoder is None else [encoder]
    return artefacts.build(out, kind="policy", config=config, parents=parents, work=work)


def _facts(config: PolicyTrainConfig, encoder: Path | None, trainer: "_PolicyTrainer") -> Mapping[str, Any]:
    kinds = {None: "none", "encoder": "offline", "log": "online"}
    lineage = None if encoder is None else artefacts.lineage(encoder)
    return {
        "task": config.task,
        "steps": trainer.step,
        "checkpoints": trainer.checkpoints,
        "agent": config.agent or _name(config, lineage),
        "encoder": kinds[None if lineage is None else lineage.kind],
        "transfer": None if encoder is None else config.transfer,
        "frozen": config.frozen,
        "seed": config.seed,
        "from_encoder": encoder is not None,
        "precision": config.ppo.precision,
        "hardware": hardware(config.threads, config.device),
    }


def _name(config: PolicyTrainConfig, lineage: artefacts.Lineage | None) -> str:
    """Name of an agent without a given name: where it started, and what differs from the defaults.

    From scratch it is `scratch` or `state`, by its observations. From an explorer's own encoder it is the explorer's
    name, `curl+ride`. From an encoder that was trained off-line it is `curl+ride-offline-curl`. `--agent` also accepts
    such names.
    """
    architecture = config.encoder.architecture
    if lineage is None:
        start = "state" if architecture == "state" else "scratch"
    else:
        start = "_".join(sorted(_explorers(lineage))) or "unknown-play"
    if lineage is not None and lineage.kind == "encoder":
        start += f"-offline-{lineage.facts.get('world_model', 'encoder')}"
    parts = [start]
    if architecture == "impala":
        parts.append(architecture)
    if lineage is not None and config.transfer != "scaled":
        parts.append(config.transfer)
    if config.frozen and architecture not in OBJECT_ENCODERS:  # these are always frozen
        parts.append("frozen")
    return "-".join(parts)


def _explorers(lineage: artefacts.Lineage) -> set[str]:
    own = {str(lineage.facts["explorer"])} if lineage.kind == "log" and "explorer" in lineage.facts else set()
    return own.union(*(_explorers(parent.lineage) for parent in lineage.parents))


def check_architecture(config: PolicyTrainConfig, encoder: Path) -> None:
    """Raise ArtefactError unless the network in `encoder` is the one in the configuration."""
    artefacts.digest(encoder)  # raises if there is none
    kind = artefacts.lineage(encoder).kind
    if kind not in {"encoder", "log"}:
        raise ArtefactError(f"{encoder}: a {kind}; give an encoder, or a log whose explorer learned one")
    artefacts.verify(encoder, kind)
    folder = encoder_folder(encoder)
    found = to_dict(read_architecture(folder, EncoderArchitecture).encoder)
    for name, expected in to_dict(config.encoder).items():
        if found[name] != expected:
            raise ArtefactError(
                f"{folder / ARCHITECTURE}: `encoder.{name}` is {found[name]}, but the policy's configuration says "
                f"{expected}; set `encoder.{name}` to match, or give another encoder"
            )
    load_encoder(encoder)  # checks that every tensor has the shape that its architecture gives


def first_images(config: PolicyTrainConfig) -> torch.Tensor:
    """First images of `config.mean_images` new training puzzles, (n, 84, 84, 3) uint8."""
    env = OpenEnv(config.task)
    seed = seeding.integer(config.seed, "policy", "mean picture")
    images = [env.reset(seed=seed if i == 0 else None)[0] for i in range(config.mean_images)]
    return torch.from_numpy(np.stack(images))


class _PolicyTrainer:
    """The state of one run, which a checkpoint holds in full."""

    def __init__(self, config: PolicyTrainConfig, encoder: Path | None, folder: Path) -> None:
        self.config = config
        self.folder = folder
        self.saved = folder / artefacts.SCRATCH / "state.safetensors"
        network = self._encoder(encoder)
        self.agent = ActorCritic(
            network, N_ACTIONS, self._torch_generator("heads"),
            trunk=config.trunk, symmetric=config.symmetric, frozen=config.frozen,
        )  # fmt: skip
        self.agent.to(config.device)
        self.optimizer = torch.optim.Adam(self._groups(), lr=config.ppo.learning_rate, eps=1e-5, fused=True)
        self.acting, self.updating = self._torch_generator("actions"), self._torch_generator("update")
        states = isinstance(network, StateEncoder)
        self.environments = TrainingEnvironments(
            config.task, config.num_envs, config.seed, states=states, threads=config.threads
        )
        self.rows: list[Row] = []
        self.checkpoints: list[dict[str, int]] = []
        self.files: dict[str, str] = {}
        """SHA-256 of every file of the policies that were saved so far, by name."""
        self.batch_size = config.num_envs * config.num_steps
        self.num_updates = -(-config.steps // self.batch_size)

    def _groups(self) -> list[dict[str, Any]]:
        """Parameters that learn. Those of the encoder are a group of their own if it has a learning rate of its own."""
        own = self.config.encoder_learning_rate
        apart = {} if own is None else dict.fromkeys(self.agent.encoder.parameters())
        learned = [parameter for parameter in self.agent.parameters() if parameter.requires_grad]
        groups = [
            {"params": [one for one in learned if one not in apart], "start": self.config.ppo.learning_rate},
            {"params": [one for one in learned if one in apart], "start": own, "lr": own},
        ]
        return [group for group in groups if group["params"]]

    def _torch_generator(self, name: str) -> torch.Generator:
        return torch.Generator().manual_seed(seeding.integer(self.config.seed, "policy", name))

    def _encoder(self, artefact: Path | None) -> ImageEncoder | StateEncoder:
        if artefact is not None:
            taught = load_encoder(artefact)
            if isinstance(taught, Encoder):  # the features of objects have one scale
                take_over(taught, self.config.transfer, first_images(self.config), self._torch_generator("encoder"))
            return taught
        encoder = make_encoder(self.config.encoder, self._torch_generator("encoder"))
        if isinstance(encoder, Encoder) and self.config.encoder.centre:
            encoder.set_mean_image(first_images(self.config))
        return encoder

    @property
    def step(self) -> int:
        """Agent steps so far, in all environments together."""
        return len(self.rows) * self.batch_size

    def run(self, tensorboard: Path | None) -> None:
        """Train to the last update, and save after each update.

        Raises:
            DivergedError: if the loss is no longer finite, naming the update and the remedy.
        """
        ppo, board = self.config.ppo, Board(tensorboard)
        with progress.bar("train policy", self.num_updates * self.batch_size, done=self.step) as bar:
            while len(self.rows) < self.num_updates:
                frac = 1.0 - len(self.rows) / self.num_updates if ppo.anneal_lr else 1.0
                for group in self.optimizer.param_groups:
                    group["lr"] = frac * group["start"]
                try:
                    rollout, episodes = self.collect(bar)
                    stats = ppo_update(self.agent, self.optimizer, rollout, ppo, self.updating)
                except DivergedError as error:
                    raise DivergedError(
                        f"train policy: update {len(self.rows) + 1} of {self.num_updates}: {error}; make "
                        f"`ppo.learning_rate` (now {ppo.learning_rate:g}) smaller, or choose `ppo.precision` fp32"
                    ) from None
                self.rows.append(self.row(episodes, stats))
                self.save()
                board.row(self.step, dict(zip(COLUMNS, self.rows[-1], strict=True)))
                bar.advance(0, note=f"return {_shown([e.total for e in episodes])} entropy {stats.entropy:.2f}")
        board.close()

    @torch.no_grad()
    def collect(self, bar: progress.Bar) -> tuple[Rollout, list[FinishedEpisode]]:
        """Act for `num_steps` in every environment."""
        config, agent, environments, device = self.config, self.agent, self.environments, self.config.device
        rollout = Rollout.empty(config.num_steps, config.num_envs, agent.obs_shape, agent.obs_dtype, device)
        last_seen: dict[tuple[int, int], np.ndarray] = {}
        episodes: list[FinishedEpisode] = []
        with autocast(config.ppo.precision, device):
            for t in range(config.num_steps):
                rollout.obs[t] = agent.observe(torch.from_numpy(environments.seen).to(device))
                action, logprob, _, value = agent.get_action_and_value(
                    agent.prepare(rollout.obs[t]), generator=self.acting
                )
                rollout.actions[t], rollout.logprobs[t], rollout.values[t] = action, logprob, value
                after = environments.step(action.cpu().numpy())
                rollout.rewards[t] = torch.from_numpy(after.rewards)
                rollout.terminations[t] = torch.from_numpy(after.terminations)
                rollout.truncations[t] = torch.from_numpy(after.truncations)
                last_seen.update({(t, env): seen for env, seen in after.last_seen.items()})
                episodes += after.episodes
                bar.advance(config.num_envs)
            rollout.next_values[:-1] = rollout.values[1:]
            rollout.next_values[-1] = self._values(environments.seen)
            if last_seen:  # the value after a truncated episode is that of its own last observation
                times, envs = (list(index) for index in zip(*last_seen, strict=True))
                rollout.next_values[times, envs] = self._values(np.stack(list(last_seen.values())))
        return rollout, episodes

    def _values(self, seen: np.ndarray) -> torch.Tensor:
        return self.agent.get_value(
            self.agent.prepare(self.agent.observe(torch.from_numpy(seen).to(self.config.device)))
        )

    def row(self, episodes: list[FinishedEpisode], stats: PPOStats) -> Row:
        """The row of curve.json for the latest update."""
        return clean(
            [
                self.step + self.batch_size, len(episodes), _mean([e.total for e in episodes]),
                _mean([float(e.success) for e in episodes]), _mean([float(e.length) for e in episodes]),
                stats.entropy, stats.approx_kl, stats.clip_fraction, stats.explained_variance,
                stats.policy_loss, stats.value_loss, self.optimizer.param_groups[0]["lr"],
            ]
        )  # fmt: skip

    def save(self) -> None:
        """Save the policy if a checkpoint is due, and write all that a resumed run needs."""
        for asked in self.config.checkpoints:
            if self.step - self.batch_size < asked <= self.step:
                self.checkpoints.append({"asked": asked, "step": self.step})
                folder = policy_folder(self.folder, self.step)
                save_policy(folder, self.agent)
                paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
                self.files |= {path.relative_to(self.folder).as_posix(): sha256_file(path) for path in paths}
        tensors = {
            **prefixed("agent", self.agent.state_dict()),
            **prefixed("optimizer", optimizer_tensors(self.optimizer)),
            "acting": self.acting.get_state(),
            "updating": self.updating.get_state(),
        }
        meta = {
            "rows": self.rows, "checkpoints": self.checkpoints, "tables": self.environments.state(),
            "files": self.files,
        }  # fmt: skip
        save_resumable(self.saved, tensors, meta)

    def resume(self) -> None:
        """Continue from the checkpoint if there is one."""
        found = load_resumable(self.saved)
        if found is None:
            return
        tensors, meta = found
        for name, digest in meta["files"].items():
            if not (self.folder / name).is_file() or sha256_file(self.folder / name) != digest:
                progress.console.print(f"{self.folder / name}: damaged; the run starts again", highlight=False)
                return
        self.agent.load_state_dict(without_prefix("agent", tensors))
        load_optimizer(self.optimizer, without_prefix("optimizer", tensors))
        self.acting.set_state(tensors["acting"])
        self.updating.set_state(tensors["updating"])
        self.rows, self.checkpoints, self.files = meta["rows"], meta["checkpoints"], meta["files"]
        self.environments.restore(meta["tables"])


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else float("nan")


def _shown(values: list[float]) -> str:
    return f"{_mean(values):.2f}" if values else "–"
