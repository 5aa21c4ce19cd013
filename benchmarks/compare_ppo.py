"""Does our PPO learn as well as Stable-Baselines3's? Learning curves of both on goal-seeking, over seeds.

Both see the simulator state (`architecture = "state"`), so that a run takes minutes. The network, the distribution of
initial weights, coefficients, environments, seeds of the puzzles and the arithmetic (fp32) are the same. Two settings
differ in name or meaning. Our value loss is half a mean square, so SB3's `vf_coef` is .25 for our .5. Values are not
clipped, because SB3 takes the clipped error where we (and OpenAI's baselines) take the larger of both errors. SB3 steps
`OpenEnv` in its own `DummyVecEnv`, so that our vector environment is compared, too.

A run consists of the mean return per update, over the episodes that ended in its rollout, and the final A-Success on
the validation puzzles. Runs that the folder has already are skipped. The script prints a table and draws both curves.

Run: uv run python benchmarks/compare_ppo.py FOLDER     (minutes per run on one idle core)
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import msgspec
import numpy as np
import torch
from gymnasium import spaces
from rich.console import Console
from rich.table import Table
from scipy import stats
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv

from gym_open import seeding
from gym_open.agents.config import EncoderConfig, PPOConfig
from gym_open.agents.encoder import StateEncoder
from gym_open.agents.policy import ActorCritic
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles.sets import puzzles_of
from gym_open.envs.state import STATE_SIZE, state_vector
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.play import Actor, play
from gym_open.evaluate.scores import summarise
from gym_open.formats.models import load_policy
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.policy import train_policy

TASK, STEPS, SEEDS, RESAMPLES = "goal-seeking", 151_552, 3, 10_000
PPO_CONFIG = PPOConfig(clip_vloss=False, precision="fp32")
CONFIG = PolicyTrainConfig(
    task=TASK, steps=STEPS, encoder=EncoderConfig(architecture="state"), trunk=(256, 256), ppo=PPO_CONFIG,
    checkpoints=(), threads=1,
)  # fmt: skip


class Run(msgspec.Struct):
    """The results of one seed."""

    returns: list[float]
    """Mean return of the episodes that ended in each rollout; if none ended, that of the rollout before."""
    a_success: float


def a_success(actor: Actor) -> float:
    """A-Success of the agent on the validation puzzles."""
    config = EvaluateConfig(task=TASK, split="validation", threads=1)
    return summarise(play(actor, TASK, puzzles_of(TASK, "validation"), config, states=True))["a_success"]


def ours(seed: int) -> Run:
    """One seed of gym-open."""
    with tempfile.TemporaryDirectory() as folder:
        policy = train_policy(msgspec.structs.replace(CONFIG, seed=seed), None, Path(folder) / "policy").path
        curve = msgspec.json.decode((policy / "curve.json").read_bytes())
        network = load_policy(policy)
    returns = [row[curve["columns"].index("mean_return")] for row in curve["rows"]]

    @torch.inference_mode()
    def actor(seen: np.ndarray) -> np.ndarray:
        return network(torch.from_numpy(seen))[0].softmax(dim=1).numpy()

    return Run(filled(returns), a_success(actor))


class StateEnv(gymnasium.ObservationWrapper[Any, Any, Any]):
    """`OpenEnv` with the simulator state as observation; its first reset has the seed of our environment `index`."""

    def __init__(self, seed: int, index: int) -> None:
        super().__init__(OpenEnv(TASK))
        self.observation_space = spaces.Box(-np.inf, np.inf, (STATE_SIZE,), np.float32)
        self.first: int | None = seeding.integer(seed, "policy", "env", index)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:  # noqa: ARG002  (SB3's own)
        given, self.first = self.first, None
        return super().reset(seed=given, options=options)

    def observation(self, observation: Any) -> np.ndarray:  # noqa: ARG002  (the image)
        env = self.unwrapped
        assert isinstance(env, OpenEnv)
        return state_vector(env.world)


class Features(BaseFeaturesExtractor):
    """Our trunk, for SB3."""

    def __init__(self, space: spaces.Box) -> None:
        super().__init__(space, CONFIG.trunk[-1])
        whole = ActorCritic(StateEncoder(CONFIG.encoder), N_ACTIONS, torch.default_generator, trunk=CONFIG.trunk)
        self.trunk = whole.trunk

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return self.trunk(observations)


class Returns(BaseCallback):
    """Mean return of the episodes that ended in each rollout."""

    def __init__(self) -> None:
        super().__init__()
        self.means: list[float | None] = []
        self.ended: list[float] = []

    def _on_step(self) -> bool:
        self.ended += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        return True

    def _on_rollout_end(self) -> None:
        self.means.append(float(np.mean(self.ended)) if self.ended else None)
        self.ended = []


def sb3(seed: int) -> Run:
    """One seed of Stable-Baselines3."""
    envs = DummyVecEnv([lambda i=i: Monitor(StateEnv(seed, i)) for i in range(CONFIG.num_envs)])
    torch.set_num_threads(1)
    model = PPO(
        "MlpPolicy", envs, learning_rate=PPO_CONFIG.learning_rate, n_steps=CONFIG.num_steps,
        batch_size=PPO_CONFIG.minibatch_size, n_epochs=PPO_CONFIG.update_epochs, gamma=PPO_CONFIG.gamma,
        gae_lambda=PPO_CONFIG.gae_lambda, clip_range=PPO_CONFIG.clip_coef, ent_coef=PPO_CONFIG.ent_coef,
        vf_coef=PPO_CONFIG.vf_coef / 2, max_grad_norm=PPO_CONFIG.max_grad_norm, seed=seed, device="cpu",
        policy_kwargs={"features_extractor_class": Features, "net_arch": []},
    )  # fmt: skip
    returns = Returns()
    model.learn(STEPS, callback=returns)

    @torch.inference_mode()
    def actor(seen: np.ndarray) -> np.ndarray:
        chances: Any = model.policy.get_distribution(torch.from_numpy(seen)).distribution
        return chances.probs.numpy()

    return Run(filled(returns.means), a_success(actor))


def filled(returns: list[float | None]) -> list[float]:
    """Fill gaps, where no episode ended, with the last known value."""
    known = [0.0]
    for value in returns:
        known.append(known[-1] if value is None else value)
    return known[1:]


CONTENDERS = {"gym-open": ours, "Stable-Baselines3": sb3}


def difference(x: np.ndarray, y: np.ndarray) -> str:
    """Difference of two means over seeds, with a bootstrap interval and with Welch's, which is wider for few seeds."""
    rng = np.random.default_rng(0)
    draws = [a[rng.integers(len(a), size=(RESAMPLES, len(a)))].mean(axis=1) for a in (x, y)]
    low, high = np.percentile(draws[0] - draws[1], [2.5, 97.5])
    welch = stats.ttest_ind(x, y, equal_var=False)
    _, p_value = welch
    wide = welch.confidence_interval()
    return (
        f"{x.mean() - y.mean():+.3f}, 95% bootstrap interval over seeds [{low:+.3f}, {high:+.3f}], "
        f"Welch's [{wide.low:+.3f}, {wide.high:+.3f}], p = {p_value:.2f}"
    )


def draw(runs: dict[str, list[Run]], path: Path) -> None:
    """Draw the mean and the range over seeds for each PPO."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    steps = CONFIG.num_envs * CONFIG.num_steps * (1 + np.arange(STEPS // (CONFIG.num_envs * CONFIG.num_steps)))
    for (name, own), colour, line in zip(runs.items(), ("#0072b2", "#d55e00"), ("-", "--"), strict=True):
        curves = np.array([run.returns for run in own])
        axes.plot(steps, curves.mean(axis=0), color=colour, linestyle=line, label=f"{name}, {len(own)} seeds")
        axes.fill_between(steps, curves.min(axis=0), curves.max(axis=0), color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel="agent steps", ylabel="return of finished episodes", title=f"PPO on the state, {TASK}")
    axes.legend(title="mean, and range of the seeds")
    axes.grid(alpha=0.3)
    figure.savefig(path, metadata={"Software": None})


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    runs: dict[str, list[Run]] = {name: [] for name in CONTENDERS}
    for seed in range(SEEDS):
        for name, train in CONTENDERS.items():
            path = folder / f"{name}-{seed}.json"
            if not path.exists():
                path.write_bytes(msgspec.json.encode(train(seed)))
            runs[name].append(msgspec.json.decode(path.read_bytes(), type=Run))
    table = Table("", "seed", "mean return over the run", "in its last tenth", "A-Success", title="PPO on the state")
    last = -(-len(runs["gym-open"][0].returns) // 10)
    for name, own in runs.items():
        for seed, run in enumerate(own):
            area, end = np.mean(run.returns), np.mean(run.returns[-last:])
            table.add_row(name, str(seed), f"{area:.3f}", f"{end:.3f}", f"{run.a_success:.3f}")
    console = Console(width=110)
    console.print(table)
    areas = [np.array([np.mean(run.returns) for run in own]) for own in runs.values()]
    scores = [np.array([run.a_success for run in own]) for own in runs.values()]
    console.print(f"area under the curve (mean return over the run), ours less SB3's: {difference(*areas)}")
    console.print(f"A-Success after it, ours less SB3's: {difference(*scores)}")
    draw(runs, folder / "curves.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
