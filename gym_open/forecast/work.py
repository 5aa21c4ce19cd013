"""Estimates how long a stage takes on this machine, and how much it writes.

The work of a stage consists of steps of a world, and images that pass through a network. `Work` counts both from the
configuration alone. `speed.py` measures in about two seconds what each costs here. The estimate is off by about a
third: good enough to choose between waiting and having lunch.
"""

import math
from collections.abc import Callable

import msgspec

from gym_open.agents.config import Device, EncoderConfig, ImagePasses
from gym_open.collect.config import CollectConfig
from gym_open.envs.tasks import step_budget
from gym_open.evaluate.config import EvaluateConfig
from gym_open.precision import PrecisionSetting
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig

PUZZLES = 100
"""Puzzles in each fixed set."""
LARGE = 128
"""Batch size above which an image does not get cheaper. Larger batches count as batches of this size."""

_RESET = 6.0
"""Cost of laying out a puzzle, in steps."""
_LOGGED, _RELEASED, _DECODED, _DRAWN = 2.0, 4.0, 1.0, 4.0
"""Cost per step, in steps, of logging it, writing it to a release, reading it from there, and recording it."""
_OVERHEAD = 1.0
"""Seconds that every stage takes for imports, checks and figures."""
_HELD_OUT_BATCHES = 4
_WARM_UP = 8
"""Moves before a probe's first image in each world."""
_PASS_FLOPS = 17e6
"""Floating-point operations of one image forward through the paper's network. It converts other work to images."""
_FIT_FLOPS = 15e9
"""Floating-point operations of fitting a linear map from 512 features, at the speed of a network."""
_PIXELS = 84 * 84 * 3
_MOVES = 8


class Passes(msgspec.Struct, frozen=True):
    """How images pass through a network."""

    network: EncoderConfig
    precision: PrecisionSetting
    device: Device
    threads: int
    batch: int
    """Images at a time."""
    learn: bool
    """Whether they pass forward and backward, or only forward."""


class Work(msgspec.Struct, frozen=True):
    """The work of a stage."""

    steps: float = 0.0
    """Steps of a world, each with its image."""
    images: dict[Passes, float] = {}
    """Number of images that pass through networks, for each way to pass."""

    def seconds(self, step: float, image: Callable[[Passes], float]) -> float:
        """Run time in seconds, given the seconds per `step` and a function for the seconds per image."""
        return _OVERHEAD + self.steps * step + sum(count * image(how) for how, count in self.images.items())


def _way(
    network: EncoderConfig, precision: PrecisionSetting, threads: int, batch: int, *, learn: bool = False,
    device: Device = "cpu",
) -> Passes:  # fmt: skip
    return Passes(network, precision, device, threads, min(batch, LARGE), learn)


def collecting(config: CollectConfig) -> Work:
    """Work of exploration: acting, rewards, learning, and the loss of each current world."""
    explorer, ppo, n = config.explorer, config.explorer.ppo, float(config.steps)
    model, acts = explorer.world_model, explorer.reward != "none"
    kind = ImagePasses(0, 0, 0) if model == "none" else explorer.section(model).passes
    shared = acts and explorer.share_encoder and kind.learned > 0
    rewarded = kind.judged if explorer.reward == "error" else int(acts)
    learned = ppo.update_epochs * (acts + kind.learned - shared)
    judged = kind.judged * config.probe / config.rollout

    def way(batch: int, *, learn: bool = False) -> Passes:
        return _way(explorer.encoder, ppo.precision, config.threads, batch, learn=learn)

    return Work(
        n * (1 + _LOGGED),
        _sum(
            (way(config.streams), n * acts),
            (way(LARGE), n * (rewarded + judged + ppo.update_epochs * kind.looked)),
            (way(ppo.minibatch_size, learn=True), n * learned),
        ),
    )


def releasing(config: CollectConfig) -> Work:
    """Work of building a release of an exploration run."""
    return Work(config.steps * _RELEASED)


def drawing(config: CollectConfig) -> Work:
    """Work of recording an exploration run for Rerun."""
    return Work(config.steps * _DRAWN)


def encoding(config: EncoderTrainConfig, frames: int) -> Work:
    """Work of training an encoder from a release of `frames` frames: decoding, updates, and held-out batches."""
    kind = config.section(config.world_model).passes
    seen = float(config.updates * config.batch_size)
    held_out = math.ceil(config.updates / config.report_every) * _HELD_OUT_BATCHES * config.batch_size * kind.judged

    def way(*, learn: bool) -> Passes:
        return _way(
            config.encoder, config.precision, config.threads, config.batch_size, learn=learn, device=config.device
        )

    return Work(
        frames * _DECODED,
        _sum((way(learn=True), seen * kind.learned), (way(learn=False), seen * kind.looked + held_out)),
    )


def probing(config: ProbeConfig, network: EncoderConfig) -> Work:
    """Work of a probe: steps in fresh worlds, features of the images, and fits of linear maps (mostly of pixels)."""
    worlds = config.train_worlds + config.validation_worlds + config.test_worlds
    one_move = config.train_worlds * config.moves / _MOVES  # of pixels, products of images take most of the time
    flops = 2 * _PIXELS * (2 * config.train_worlds**2 + _MOVES * one_move**2) if config.pixels else 0.0
    flops += (2 + _MOVES) * (1 + config.untrained) * _FIT_FLOPS * (network.features / 512) ** 3
    fp32 = _way(network, "fp32", config.threads, LARGE)
    return Work(
        worlds * (_RESET + _WARM_UP + config.moves + 1),
        _sum(
            (fp32, worlds * (config.moves + 1.0) * (1 + config.untrained) + flops / _PASS_FLOPS),
        ),
    )


def learning(config: PolicyTrainConfig, *, encoder: bool) -> Work:
    """Work of PPO on a task, from an `encoder` or from scratch."""
    rollout = config.num_envs * config.num_steps
    n = float(math.ceil(config.steps / rollout) * rollout)
    ppo, first = config.ppo, float(config.mean_images)

    def way(precision: PrecisionSetting, batch: int, *, learn: bool = False) -> Passes:
        return _way(config.encoder, precision, config.threads, batch, learn=learn, device=config.device)

    return Work(
        n + first * _RESET,
        _sum(
            (way(ppo.precision, config.num_envs), n * (1 + 1 / config.num_steps)),
            (way(ppo.precision, ppo.minibatch_size, learn=True), 0.0 if config.frozen else n * ppo.update_epochs),
            (way("fp32", LARGE), 2 * first if encoder and config.transfer != "weights" else 0.0),
        ),
    )


def playing(config: EvaluateConfig, network: EncoderConfig | None) -> Work:
    """Work of scoring on the fixed puzzles: a policy with this network, or random actions."""
    n = float(PUZZLES * step_budget(config.task))
    images = {} if network is None else _sum((_way(network, "fp32", config.threads, PUZZLES), n))
    return Work(n + PUZZLES * _RESET, images)


def bytes_written(config: CollectConfig) -> int:
    """Approximate disk space of a whole run: its steps in log, release and recording, and a dozen networks."""
    return config.steps * (3_000 + 20_000 * (config.log.depth + config.log.segmentation)) + 100_000_000


def about(seconds: float) -> str:
    """An expected time in words, rounded to its accuracy: about 4 min."""
    minutes = seconds / 60
    if minutes < 0.75:
        return "less than a minute"
    if minutes < 15:
        return f"about {minutes:.0f} min"
    if minutes < 90:
        return f"about {5 * round(minutes / 5)} min"
    return f"about {round(minutes / 60)} h"


def _sum(*parts: tuple[Passes, float]) -> dict[Passes, float]:
    total: dict[Passes, float] = {}
    for how, count in parts:
        if count:
            total[how] = total.get(how, 0.0) + count
    return total
