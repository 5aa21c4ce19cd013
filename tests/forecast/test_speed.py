"""What this machine does in a second is tried for a moment, and nothing is changed by it."""

import pytest
import torch

from gym_open.agents.config import EncoderConfig
from gym_open.forecast import speed
from gym_open.forecast.work import Passes, Work

SMALL = EncoderConfig(features=16)


def test_a_mean_does_not_count_the_first_time_and_ends_when_it_is_enough() -> None:
    now, calls = 0.0, 0

    def once() -> None:
        nonlocal now, calls
        calls += 1
        now += 5.0 if calls == 1 else 0.04

    assert speed.mean_time(once, 1000, clock=lambda: now) == pytest.approx(0.04)
    assert calls == 1 + 4  # until 0.15 s have passed
    assert speed.mean_time(once, 2, clock=lambda: now) == pytest.approx(0.04)
    assert calls == 5 + 1 + 2
    assert speed.mean_time(once, 0.1, clock=lambda: now) == pytest.approx(0.04)  # once at least


@pytest.mark.parametrize("learn", [False, True])
def test_a_picture_costs_something_and_threads_stay_as_they_were(learn: bool) -> None:
    threads, state = torch.get_num_threads(), torch.random.get_rng_state()
    assert speed.cost_of_picture(Passes(SMALL, "fp32", "cpu", threads + 1, 4, learn), 4) > 0
    assert torch.get_num_threads() == threads
    assert torch.equal(torch.random.get_rng_state(), state)


def test_stages_that_ask_for_more_are_expected_to_take_longer() -> None:
    how = Passes(SMALL, "auto", "cpu", 1, 4, learn=False)
    little, much = (speed.seconds([Work(steps, {how: steps})]) for steps in (1.0, 1e9))
    assert much > 1000 * little


def test_auto_is_measured_as_what_it_means() -> None:
    assert speed.settled(Passes(SMALL, "auto", "cpu", 1, 4, learn=True)).precision in ("fp32", "bf16")
