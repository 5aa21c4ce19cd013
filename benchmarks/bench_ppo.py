"""Speed of PPO on images, compared with its matrix products alone and with Stable-Baselines3.

The network's multiplications, at the best speed for large matrices (`products`), are a lower bound for any
implementation. The table also shows the parts: the environments alone, the network's forward pass alone for acting, and
its forward and backward pass alone for the update's epochs. Stable-Baselines3's PPO has the same network, environments
(stepped by our `TrainingEnvironments`, which are faster than its own), batch and epochs. It learns in fp32, and neither
centres nor shifts images.

Candidates take turns, so that a busy machine slows all of them equally. A ratio is the median over rounds of the ratio
within a round. With one thread, the clock is processor time, which does not count other processes. Two threads can only
be compared on an otherwise idle machine.

To make a processor with AVX-512 behave like one without it, set limits for three libraries (torch's matrix products are
MKL's, which uses AVX2 on AMD processors anyway):

    ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2 NUMBA_CPU_NAME=haswell NUMBA_CPU_FEATURES=+avx2,+fma

Run: uv run python benchmarks/bench_ppo.py [--threads 1 2] [--rounds 3]     (five minutes on two idle cores)
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import torch
from gymnasium import spaces
from rich.console import Console
from rich.table import Table
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from gym_open.agents.config import PPOConfig
from gym_open.agents.encoder import IMAGE_SHAPE, autocast
from gym_open.agents.ppo import ppo_update
from gym_open.agents.threads import threads as sharing
from gym_open.envs.constants import N_ACTIONS
from gym_open.precision import Precision, native_precision
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.environments import TrainingEnvironments
from gym_open.train.policy import _PolicyTrainer

SB3 = "Stable-Baselines3, fp32"
N_ENVS, N_STEPS = 32, 64
BATCH = N_ENVS * N_STEPS
PPO_CONFIG = PPOConfig()
UPDATES = PPO_CONFIG.update_epochs * BATCH // PPO_CONFIG.minibatch_size
MFLOP_FORWARD = 2e-6 * (400 * 32 * 192 + 81 * 64 * 512 + 49 * 64 * 576 + 3136 * 512)
"""MFLOP per image: places × outputs × inputs of each convolution, and of the linear layer."""
MFLOP_BACKWARD = 2 * MFLOP_FORWARD - 2e-6 * 400 * 32 * 192
"""The first layer does not compute a gradient of its input."""
Work = Callable[[], object]


class TablesVecEnv(VecEnv):
    """Our environments for SB3."""

    def __init__(self, threads: int) -> None:
        super().__init__(N_ENVS, spaces.Box(0, 255, IMAGE_SHAPE, np.uint8), spaces.Discrete(N_ACTIONS))
        self.tables = TrainingEnvironments("goal-seeking", N_ENVS, 0, threads=threads)

    def reset(self) -> Any:
        return self.tables.seen.copy()

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions

    def step_wait(self) -> Any:
        after = self.tables.step(self.actions)
        infos: list[dict[str, Any]] = [{} for _ in range(N_ENVS)]
        for i, seen in after.last_seen.items():
            infos[i] = {"terminal_observation": seen, "TimeLimit.truncated": True}
        return self.tables.seen.copy(), after.rewards, after.terminations | after.truncations, infos

    def close(self) -> None: ...

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ARG002
        return [None] * N_ENVS

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None: ...

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:  # noqa: ARG002  (the interface)
        raise AttributeError(
            f"{method_name}: worlds in `TrainingEnvironments` have no methods that SB3's PPO would call"
        )

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:  # noqa: ARG002
        return [False] * N_ENVS


class _Ready(BaseCallback):
    """Keeps SB3's callback, so that rollouts can be requested one by one."""

    def _on_step(self) -> bool:
        return True


def alone(work: Work, threads: int) -> Work:
    """The same work with our number of threads."""

    def done() -> None:
        with sharing(threads):
            work()

    return done


def with_torchs(work: Work, threads: int) -> Work:
    """The same work with PyTorch's own number of threads."""

    def done() -> None:
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        work()
        torch.set_num_threads(before)

    return done


def ours(threads: int, precision: Precision) -> tuple[Work, _PolicyTrainer]:
    """A rollout and its update, and the trainer that does it."""
    ppo = msgspec.structs.replace(PPO_CONFIG, precision=precision)
    config = PolicyTrainConfig(num_envs=N_ENVS, num_steps=N_STEPS, ppo=ppo, threads=threads)
    with tempfile.TemporaryDirectory() as folder:
        trainer = _PolicyTrainer(config, None, Path(folder))
    bar: Any = SimpleNamespace(advance=lambda _: None)

    def work() -> None:
        rollout, _ = trainer.collect(bar)
        ppo_update(trainer.agent, trainer.optimizer, rollout, ppo, trainer.updating)

    return work, trainer


def sb3(threads: int) -> Work:
    """A rollout and its update by Stable-Baselines3."""
    config, callback = PPO_CONFIG, _Ready()
    model = PPO(
        "CnnPolicy", TablesVecEnv(threads), learning_rate=config.learning_rate, n_steps=N_STEPS,
        batch_size=config.minibatch_size, n_epochs=config.update_epochs, gamma=config.gamma,
        gae_lambda=config.gae_lambda, clip_range=config.clip_coef, ent_coef=config.ent_coef,
        vf_coef=config.vf_coef / 2, max_grad_norm=config.max_grad_norm, device="cpu", seed=0,
    )  # fmt: skip
    BaseAlgorithm._setup_learn(model, BATCH, callback)  # noqa: SLF001  (what `learn` does first)
    callback.init_callback(model)

    def work() -> None:
        assert model.env is not None
        model.collect_rollouts(model.env, callback, model.rollout_buffer, n_rollout_steps=N_STEPS)
        model.train()

    return work


def environment(trainer: _PolicyTrainer) -> None:
    """The environments alone, under random actions."""
    for actions in np.random.default_rng(0).integers(0, N_ACTIONS, (N_STEPS, N_ENVS)):
        trainer.environments.step(actions)


@torch.no_grad()
def acting(trainer: _PolicyTrainer) -> None:
    """The network alone, on prepared images."""
    with autocast(trainer.config.ppo.precision):
        prepared = trainer.agent.prepare(torch.from_numpy(trainer.environments.seen))
        for _ in range(N_STEPS):
            trainer.agent(prepared)


def updating(trainer: _PolicyTrainer) -> None:
    """Forward and backward pass alone, on a prepared minibatch."""
    size = PPO_CONFIG.minibatch_size
    with autocast(trainer.config.ppo.precision):
        seen = torch.from_numpy(trainer.environments.seen)
        prepared = trainer.agent.prepare(seen.repeat(size // N_ENVS, 1, 1, 1))
    for _ in range(UPDATES):
        with autocast(trainer.config.ppo.precision):
            logits, values = trainer.agent(prepared)
        trainer.agent.zero_grad()
        (logits.sum() + values.sum()).backward()


def products(mflop: float, precision: Precision) -> None:
    """`mflop` million multiplications and additions, in large matrices."""
    edge = 1024
    a = torch.ones(edge, edge, dtype=torch.bfloat16 if precision == "bf16" else torch.float32)
    out = torch.empty_like(a)
    for _ in range(round(1e6 * mflop / (2 * edge**3))):
        torch.mm(a, a, out=out)


def seconds(work: Work, threads: int) -> float:
    """Seconds that work takes: processor time for one thread, otherwise wall time."""
    clock = time.process_time if threads == 1 else time.perf_counter
    began = clock()
    work()
    return clock() - began


def compare(work: dict[str, Work], threads: int, rounds: int) -> dict[str, list[float]]:
    """Seconds of each work in each round, after one run of each."""
    for one in work.values():  # compiles, and fills caches
        one()
    found: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, one in work.items():
            found[name].append(seconds(one, threads))
    return found


def ratio(times: list[float], base: list[float]) -> str:
    """Median over rounds of the ratio to `base`."""
    return f"{statistics.median(t / b for t, b in zip(times, base, strict=True)):.2f}"


def measure(threads: int, rounds: int) -> Table:
    """One row per candidate, and one per part of ours."""
    precisions: list[Precision] = ["bf16", "fp32"] if native_precision() == "bf16" else ["fp32"]
    work: dict[str, Work] = {SB3: with_torchs(sb3(threads), threads)}
    for precision in precisions:
        whole, trainer = ours(threads, precision)
        parts = {
            "": whole, ": the environments alone": partial(environment, trainer),
            ": acting alone": partial(acting, trainer), ": forward and backward alone": partial(updating, trainer),
        }  # fmt: skip
        work |= {f"gym-open, {precision}{part}": alone(one, threads) for part, one in parts.items()}
        mflop = BATCH * (MFLOP_FORWARD + PPO_CONFIG.update_epochs * (MFLOP_FORWARD + MFLOP_BACKWARD))
        work[f"products, {precision}"] = with_torchs(partial(products, mflop, precision), threads)
    found = compare(work, threads, rounds)
    table = Table("", "steps/s", "× the products' time", "× SB3's speed", title=f"PPO from images, threads: {threads}")
    for name, times in found.items():
        base = found[f"products, {'bf16' if 'bf16' in name else 'fp32'}"]
        table.add_row(name, f"{BATCH / statistics.median(times):,.0f}", ratio(times, base), ratio(found[SB3], times))
    return table


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    for threads in options.threads:
        Console(width=120).print(measure(threads, options.rounds))


if __name__ == "__main__":
    main()
