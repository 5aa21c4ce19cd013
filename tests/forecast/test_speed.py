"""Short measurements of this machine, which change no settings."""

import pytest
import torch

from gym_open.agents.config import EncoderConfig
from gym_open.forecast import speed
from gym_open.forecast.work import Passes, Work

SMALL = EncoderConfig(features=16)


@pytest.mark.parametrize(
    ("took", "most", "usual", "times"),
    [
        ([0.04] * 9, 1000, 0.04, 4),  # until 0.15 s have passed
        ([0.8, 0.04, 0.05, 9.0], 1000, 0.05, 3),  # at least three calls, of which one is delayed
        ([2.0, 0.04, 0.05, 9.0], 1000, 2.0, 1),  # unless they take long
        ([0.04] * 9, 2, 0.04, 2),
        ([0.04] * 9, 0.1, 0.04, 1),
    ],
)
def test_the_usual_time_is_a_median_without_the_first_time(
    took: list[float], most: float, usual: float, times: int
) -> None:
    now, left = 0.0, [5.0, *took]

    def once() -> None:
        nonlocal now
        now += left.pop(0)

    assert speed.usual_time(once, most, clock=lambda: now) == pytest.approx(usual)
    assert len(took) - len(left) == times


@pytest.mark.parametrize("learn", [False, True])
def test_an_image_costs_something_and_threads_stay_as_they_were(learn: bool) -> None:
    threads, state = torch.get_num_threads(), torch.random.get_rng_state()
    assert speed.cost_of_image(Passes(SMALL, "fp32", "cpu", threads + 1, 4, learn), 4) > 0
    assert torch.get_num_threads() == threads
    assert torch.equal(torch.random.get_rng_state(), state)


def test_stages_with_more_work_are_expected_to_take_longer() -> None:
    how = Passes(SMALL, "auto", "cpu", 1, 4, learn=False)
    little, much = (speed.seconds([Work(steps, {how: steps})]) for steps in (1.0, 1e9))
    assert much > 1000 * little


def test_auto_is_measured_as_what_it_means() -> None:
    assert speed.settled(Passes(SMALL, "auto", "cpu", 1, 4, learn=True)).precision in ("fp32", "bf16")
