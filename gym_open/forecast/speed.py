"""Short measurements of this machine: seconds per step of a world, and per image through a network."""

import statistics
import time
from collections.abc import Callable

import msgspec
import torch

from gym_open.agents.architectures import make_image_encoder
from gym_open.agents.augment import draw_shifts
from gym_open.agents.config import OBJECT_ENCODERS
from gym_open.agents.encoder import IMAGE_SHAPE, autocast
from gym_open.agents.policy import ActorCritic
from gym_open.agents.threads import threads
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.forecast.work import Passes, Work
from gym_open.precision import resolve

ENOUGH = 0.15
"""Seconds that one measurement lasts, if it is not finished sooner."""
LONG = 1.0
"""Seconds after which a measurement is not repeated."""
SHARE = 50
"""No measurement processes more than this fraction (1/50) of the work that it is for."""


def seconds(works: list[Work]) -> float:
    """Approximate run time of some stages here, one after another, from measurements of their main kinds of work."""
    total: dict[Passes, float] = {}
    for work in works:
        for how, count in work.images.items():
            total[settled(how)] = total.get(settled(how), 0.0) + count
    costs = {how: cost_of_image(how, count / SHARE) for how, count in total.items()}
    step = cost_of_step(sum(work.steps for work in works) / SHARE)
    return sum(work.seconds(step, lambda how: costs[settled(how)]) for work in works)


def get_ready(works: list[Work]) -> None:
    """Do everything once that is measured later: compiling takes up to a minute at the first use."""
    cost_of_step(1)
    ways = {settled(how) for work in works for how in work.images}
    for how in {msgspec.structs.replace(how, batch=4, threads=1) for how in ways}:
        cost_of_image(how, 1)


def settled(how: Passes) -> Passes:
    """The same passes with the precision that `auto` means here."""
    return msgspec.structs.replace(how, precision=resolve(how.precision, how.device))


def cost_of_step(most: float = 1000) -> float:
    """Seconds per step of a world, including its image. At most about `most` steps are measured."""
    env = OpenEnv("goal-seeking")
    env.reset(seed=0)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(1)
        if terminated or truncated:
            env.reset()

    return usual_time(step, most)


def cost_of_image(how: Passes, most: float = 1000) -> float:
    """Seconds per image that passes through a network. At most about `most` images are measured."""
    # Layers draw weights from PyTorch's global generator before they get their own weights.
    with threads(how.threads), torch.random.fork_rng(devices=[]):
        return usual_time(_pass(how), most / how.batch) / how.batch


def _pass(how: Passes) -> Callable[[], float]:
    """A function that passes one batch through the network."""
    generator = torch.Generator().manual_seed(0)
    agent = ActorCritic(make_image_encoder(how.network, generator), N_ACTIONS, generator).to(how.device)
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-4, fused=True)
    images = torch.randint(256, (how.batch, *IMAGE_SHAPE), dtype=torch.uint8, generator=generator).to(how.device)
    shifts = draw_shifts(how.batch, 4, generator)

    def look() -> float:
        with torch.no_grad(), autocast(how.precision, how.device):
            return float(agent(agent.encoder.prepare(images))[1].sum())  # a Python number: this waits for a GPU

    def learn() -> float:
        with autocast(how.precision, how.device):
            logits, values = agent(agent.encoder.prepare_shifted(images, shifts))
        optimizer.zero_grad()
        (logits.mean() + values.mean()).backward()
        optimizer.step()
        return float(values.detach().sum())

    return learn if how.learn and how.network.architecture not in OBJECT_ENCODERS else look


def usual_time(once: Callable[[], object], most: float, *, clock: Callable[[], float] = time.perf_counter) -> float:
    """Median seconds of several calls of `once`, after a first call that does not count.

    The measurement lasts `ENOUGH` seconds. It has at least three calls, unless these take longer than `LONG`, and at
    most `most` calls. One of three calls may be delayed by other processes.
    """
    once()
    times: list[float] = []
    while len(times) < max(most, 1) and sum(times) < (ENOUGH if len(times) >= 3 else LONG):
        started = clock()
        once()
        times.append(clock() - started)
    return statistics.median(times)
