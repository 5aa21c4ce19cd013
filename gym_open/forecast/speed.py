"""What this machine does in a second: steps of a world, and pictures through a network, each tried for a moment."""

import statistics
import time
from collections.abc import Callable

import msgspec
import torch

from gym_open.agents.augment import draw_shifts
from gym_open.agents.encoder import IMAGE_SHAPE, Encoder, autocast
from gym_open.agents.policy import ActorCritic
from gym_open.agents.threads import threads
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.forecast.work import Passes, Work
from gym_open.precision import resolve

ENOUGH = 0.15
"""Seconds that one thing is tried for, if it is not done sooner."""
LONG = 1.0
"""Seconds after which it is not tried again."""
SHARE = 50
"""Nothing is tried for longer than this part of all that is to be done."""


def seconds(works: list[Work]) -> float:
    """About how long some stages take here, one after another, measured on what they ask for most."""
    total: dict[Passes, float] = {}
    for work in works:
        for how, count in work.pictures.items():
            total[settled(how)] = total.get(settled(how), 0.0) + count
    costs = {how: cost_of_picture(how, count / SHARE) for how, count in total.items()}
    step = cost_of_step(sum(work.steps for work in works) / SHARE)
    return sum(work.seconds(step, lambda how: costs[settled(how)]) for work in works)


def get_ready(works: list[Work]) -> None:
    """Let everything that is measured happen once: what is compiled on its first use takes up to a minute then."""
    cost_of_step(1)
    ways = {settled(how) for work in works for how in work.pictures}
    for how in {msgspec.structs.replace(how, batch=4, threads=1) for how in ways}:
        cost_of_picture(how, 1)


def settled(how: Passes) -> Passes:
    """The same with the precision that `auto` means here."""
    return msgspec.structs.replace(how, precision=resolve(how.precision, how.device))


def cost_of_step(most: float = 1000) -> float:
    """Seconds that a step of a world takes, its picture included; `most` steps are enough to tell."""
    env = OpenEnv("goal-seeking")
    env.reset(seed=0)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(1)
        if terminated or truncated:
            env.reset()

    return usual_time(step, most)


def cost_of_picture(how: Passes, most: float = 1000) -> float:
    """Seconds that a picture takes to pass through a network; `most` pictures are enough to tell."""
    # Layers draw weights from PyTorch's own generator before they are given theirs.
    with threads(how.threads), torch.random.fork_rng(devices=[]):
        return usual_time(_pass(how), most / how.batch) / how.batch


def _pass(how: Passes) -> Callable[[], float]:
    """Something that lets one batch pass."""
    generator = torch.Generator().manual_seed(0)
    agent = ActorCritic(Encoder(how.network, generator), N_ACTIONS, generator).to(how.device)
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-4, fused=True)
    images = torch.randint(256, (how.batch, *IMAGE_SHAPE), dtype=torch.uint8, generator=generator).to(how.device)
    shifts = draw_shifts(how.batch, 4, generator)

    def look() -> float:
        with torch.no_grad(), autocast(how.precision, how.device):
            return float(agent(agent.encoder.prepare(images))[1].sum())  # a number here: a GPU is waited for

    def learn() -> float:
        with autocast(how.precision, how.device):
            logits, values = agent(agent.encoder.prepare_shifted(images, shifts))
        optimizer.zero_grad()
        (logits.mean() + values.mean()).backward()
        optimizer.step()
        return float(values.detach().sum())

    return learn if how.learn else look


def usual_time(once: Callable[[], object], most: float, *, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds that `once` takes, the median of several times after a first that does not count.

    It is tried for `ENOUGH` seconds and, if that takes no longer than `LONG`, three times at least, or `most` times. Of
    three, one may be held up by other processes.
    """
    once()
    times: list[float] = []
    while len(times) < max(most, 1) and sum(times) < (ENOUGH if len(times) >= 3 else LONG):
        started = clock()
        once()
        times.append(clock() - started)
    return statistics.median(times)
