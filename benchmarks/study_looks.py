"""Do objects from play depend on the look of this world? The whole chain in worlds of other cameras, lights, colours.

    .venv/bin/python benchmarks/study_looks.py --out /tmp/looks                          # all looks, colour slots
    .venv/bin/python benchmarks/study_looks.py --out /tmp/looks --architecture keypoints --looks published above

In each look: random moves, an encoder of objects from them, PPO on a task, and A-Success on the validation puzzles.
Nothing is known about the look in advance. Results are kept in `--out`, so a stopped study continues.
"""

import argparse
import json
from pathlib import Path

import msgspec
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from rich.console import Console
from rich.table import Table

from gym_open import artefacts, progress, seeding
from gym_open.agents.architectures import make_image_encoder
from gym_open.agents.config import ObjectsConfig
from gym_open.agents.objects import Objects
from gym_open.agents.objects.encoders import ObjectEncoder
from gym_open.agents.world_model import TransitionBatch
from gym_open.config import load
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.options import CameraOptions, LightOptions, ObjectOptions, WorldOptions
from gym_open.envs.puzzles.sets import puzzles_of
from gym_open.envs.vector import OpenVectorEnv
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.play import load_actor, play
from gym_open.evaluate.scores import summarise
from gym_open.formats.models import save_encoder, save_policy
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig
from gym_open.train.environments import TrainingEnvironments
from gym_open.train.policy import _PolicyTrainer

ROOT = Path(__file__).parents[1]
WORLDS, MOVES, SIDE = 3000, 4, 50
"""Worlds and moves in each, and worlds side by side."""


def colours(**chosen: tuple[int, int, int]) -> dict[str, ObjectOptions]:
    """Options with these colours by kind."""
    return {kind: ObjectOptions(colour=colour) for kind, colour in chosen.items()}


LOOKS = {
    "published": WorldOptions(),
    "above": WorldOptions(camera=CameraOptions(position=(0.0, 0.0, 2.1), direction=(90.0, 0.0, 0.0))),
    "other side": WorldOptions(camera=CameraOptions(position=(0.9, 1.7, 1.1), direction=(42.0, 208.0, 0.0))),
    "low": WorldOptions(camera=CameraOptions(position=(-0.3, -2.0, 0.8), direction=(28.0, 9.0, 0.0))),
    "flat light": WorldOptions(light=LightOptions(angle_deg=40.0, elevation_deg=15.0)),
    "other colours": WorldOptions(
        objects=colours(
            agent=(40, 200, 220), yellow=(200, 60, 200), green=(240, 240, 240), heavy=(30, 30, 30), light=(250, 150, 60)
        )
    ),
    "pale colours": WorldOptions(
        objects=colours(
            agent=(90, 120, 95), yellow=(70, 110, 60), green=(60, 125, 100), heavy=(40, 85, 85), light=(75, 90, 75)
        )
    ),
}
"""Pale colours are within 50 of the table's green in each channel."""


def explore(world: WorldOptions, seed: int) -> TransitionBatch:
    """Random moves in new worlds."""
    env = OpenVectorEnv(SIDE, "sandbox", world=world, autoreset_mode=AutoresetMode.DISABLED, copy=True, threads=1)
    rng, parts = seeding.generator(seed, "looks", "play"), list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    with progress.bar("play", WORLDS * MOVES) as bar:
        for _ in range(WORLDS // SIDE):
            seen, _ = env.reset(seed=rng.integers(0, 2**31, SIDE).tolist())
            for _ in range(MOVES):
                actions = rng.integers(0, N_ACTIONS, SIDE)
                after = env.step(actions)[0]
                parts.append((seen, actions, after))
                seen = after
                bar.advance(SIDE)
    obs, actions, next_obs = (torch.from_numpy(np.concatenate(part)) for part in zip(*parts, strict=True))
    return TransitionBatch(obs, actions, next_obs)


def learn(settings: EncoderTrainConfig, moves: TransitionBatch) -> tuple[ObjectEncoder, dict[str, float]]:
    """An encoder of objects from moves, as `train encoder` makes it from a release; and facts about it."""
    init = torch.Generator().manual_seed(seeding.integer(settings.seed, "looks", "init"))
    encoder = make_image_encoder(settings.encoder, init)
    assert isinstance(encoder, ObjectEncoder)
    encoder.set_mean_image(moves.obs)
    model = Objects(encoder, ObjectsConfig(), N_ACTIONS, init)
    model.watch(moves.obs)
    optimizer = torch.optim.Adam([one for one in model.parameters() if one.requires_grad], lr=settings.learning_rate)
    rng, figures = seeding.generator(settings.seed, "looks", "batches"), dict[str, torch.Tensor]()
    with progress.bar("objects", settings.updates) as bar:
        for _ in range(settings.updates):
            chosen = torch.from_numpy(rng.integers(0, len(moves.obs), settings.batch_size))
            loss, figures = model.measure(TransitionBatch(*(part[chosen] for part in moves)), chosen, init)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            bar.advance()
    return encoder, {"inverse_accuracy": float(figures["inverse_accuracy"]), **model.finish(moves)}


def score(config: PolicyTrainConfig, encoder: Path, world: WorldOptions, folder: Path) -> float:
    """A-Success of a policy that learned from an encoder in such worlds."""
    trainer = _PolicyTrainer(config, encoder, folder)
    trainer.environments = TrainingEnvironments(config.task, config.num_envs, config.seed, world=world)
    trainer.run(None)
    save_policy(folder, trainer.agent)
    evaluation = EvaluateConfig(task=config.task, split="validation", threads=1)
    actor, _ = load_actor(folder, evaluation)
    played = play(actor, config.task, puzzles_of(config.task, "validation"), evaluation, world=world)
    return summarise(played)["a_success"]


def study(look: str, out: Path, *, architecture: str, task: str, steps: int, seed: int) -> dict[str, float]:
    """The result of one look, computed unless it is kept."""
    folder = out / f"{look.replace(' ', '-')}-{architecture}-{task}-{steps}-seed{seed}"
    kept = folder / "result.json"
    if not kept.exists():
        settings = load(ROOT / "train/encoder-objects.toml", EncoderTrainConfig)
        network = msgspec.structs.replace(settings.encoder, architecture=architecture)
        longer = {"updates": 700, "batch_size": 40} if architecture == "keypoints" else {}
        settings = msgspec.structs.replace(settings, encoder=network, seed=seed, **longer)
        policy = load(ROOT / f"train/policy-objects{'-tool-use' if task == 'tool-use' else ''}.toml", PolicyTrainConfig)
        policy = msgspec.structs.replace(policy, task=task, steps=steps, encoder=network, seed=seed, checkpoints=())
        torch.set_num_threads(1)
        encoder, facts = learn(settings, explore(LOOKS[look], seed))

        def keep(partial: Path) -> dict[str, float]:
            save_encoder(partial, encoder)
            return facts

        made = artefacts.build(folder / "encoder", kind="encoder", config=settings, parents=[], work=keep).path
        (folder / "policy").mkdir(exist_ok=True)
        result = {**facts, "a_success": score(policy, made, LOOKS[look], folder / "policy")}
        kept.write_text(json.dumps(result))
    return json.loads(kept.read_text())


def main() -> None:
    """Print one row per look."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--looks", nargs="+", choices=LOOKS, default=list(LOOKS))
    parser.add_argument("--architecture", choices=("slots", "keypoints"), default="slots")
    parser.add_argument("--task", default="goal-seeking")
    parser.add_argument("--steps", type=int, default=51_200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    table = Table("look", "names the action", "error of the table (moves)", "A-Success", title=f"{given.task}")
    for look in given.looks:
        found = study(
            look, given.out, architecture=given.architecture, task=given.task, steps=given.steps, seed=given.seed
        )
        table.add_row(
            look, f"{found['inverse_accuracy']:.2f}", f"{found['plane_error']:.3f}", f"{found['a_success']:.3f}"
        )
    Console().print(table)


if __name__ == "__main__":
    main()
