"""Stable-Baselines3's unchanged PPO on our unchanged environments."""

from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import gym_open
from gym_open.envs.env import OpenEnv
from gym_open.results.metrics import a_success, mean_return_within

ID = gym_open.ENV_IDS["goal-seeking"]
BUDGET = 100


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """With other load on the machine, torch's threads wait for one another."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


class Positions(gymnasium.ObservationWrapper[np.ndarray, np.int64, dict[str, np.ndarray]]):
    """Positions of all objects on the table, relative to the agent, in cells: enough to learn without images."""

    def __init__(self, env: gymnasium.Env[dict[str, np.ndarray], np.int64]) -> None:
        super().__init__(env)
        assert isinstance(env.unwrapped, OpenEnv)
        n = len(env.unwrapped.world.inventory)
        self.observation_space = gymnasium.spaces.Box(-50, 50, (2 * n,), np.float32)

    def observation(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        state, present = observation["object_state"], observation["present"] == 1
        seen = (state[:, :2] - state[0, :2]) / 0.141
        seen[0] = state[0, :2] / 0.141
        seen[~present] = 0
        return seen.ravel()


def success(model: PPO | None, episodes: int = 60) -> float:
    """A-Success on training puzzles; without a model, of uniformly random actions."""
    env = Positions(gymnasium.make(ID, observation="dict"))
    rng = np.random.default_rng(0)
    rewards = np.zeros((episodes, BUDGET))
    for episode in range(episodes):
        seen, _ = env.reset(seed=10_000 + episode)
        for step in range(BUDGET):
            action = rng.integers(9) if model is None else model.predict(seen)[0]
            seen, rewards[episode, step], terminated, truncated, _ = env.step(np.int64(action))
            if terminated or truncated:
                break
    return a_success(mean_return_within(rewards))


def test_ppo_runs_on_images() -> None:
    env = make_vec_env(ID, n_envs=2)
    model = PPO("CnnPolicy", env, n_steps=8, batch_size=16, n_epochs=1, device="cpu").learn(32)
    seen: Any = env.reset()
    assert model.predict(seen)[0].shape == (2,)


def test_ppo_runs_on_dictionaries() -> None:
    env = make_vec_env(ID, n_envs=2, env_kwargs={"observation": "dict"})
    model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, n_epochs=1, device="cpu").learn(32)
    seen: Any = env.reset()
    assert model.predict(seen)[0].shape == (2,)


@pytest.mark.slow
def test_ppo_learns_to_seek_the_goal() -> None:
    env = make_vec_env(
        ID,
        n_envs=8,
        seed=0,
        env_kwargs={"observation": "dict"},
        wrapper_class=Positions,  # pyright: ignore[reportArgumentType]
    )
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=256,
        batch_size=512,
        gamma=0.95,
        gae_lambda=0.95,
        learning_rate=1e-3,
        ent_coef=0.005,
        seed=0,
        device="cpu",
    )
    model.learn(50_000)
    by_chance, learnt = success(None), success(model)
    assert by_chance < 0.2
    assert learnt > 2.5 * by_chance
