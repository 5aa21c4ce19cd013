"""The work of stages follows from their configurations: in closed form, and in proportion."""

import msgspec
import pytest

from gym_open.agents.config import EncoderConfig, ExplorerConfig, RewardName, WorldModelName
from gym_open.collect.config import CollectConfig, LogConfig
from gym_open.evaluate.config import EvaluateConfig
from gym_open.forecast import work
from gym_open.forecast.work import Passes, Work
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig, ProbeConfig

NETWORK = EncoderConfig()


def counts(done: Work) -> dict[tuple[int, bool], float]:
    """Images by batch size, and by whether they are learned from."""
    return {(how.batch, how.learn): count for how, count in done.images.items()}


def test_seconds_are_the_sum_of_all_that_is_done() -> None:
    passes = Passes(NETWORK, "fp32", "cpu", 1, 4, learn=False)
    learned = msgspec.structs.replace(passes, learn=True)
    costs = {passes: 0.25, learned: 2.0}
    nothing = Work().seconds(0.5, costs.__getitem__)
    assert Work(10, {passes: 8, learned: 3}).seconds(0.5, costs.__getitem__) == nothing + 5 + 2 + 6


@pytest.mark.parametrize(
    ("model", "reward", "shared", "passes"),
    [
        ("none", "none", True, (0, 0, 0)),
        ("curl", "none", True, (0, 2 + 3, 3)),  # the losses of a rollout, then keys
        ("curl", "ride", True, (1, 1 + 2 + 3, 3)),
        ("curl", "ride", False, (1, 1 + 2 + 3, 6)),
        ("rnd", "error", True, (1, 2 + 2 + 3, 3)),
        ("icm", "error", True, (1, 2 + 2, 6)),
        ("icm", "counted-ride", False, (1, 1 + 2, 9)),
    ],
)
def test_exploration_counts_every_pass_of_a_step(
    model: WorldModelName, reward: RewardName, shared: bool, passes: tuple[int, int, int]
) -> None:
    acted, looked, learned = passes
    explorer = ExplorerConfig(world_model=model, reward=reward, share_encoder=shared)
    config = CollectConfig(steps=1000, streams=4, rollout=64, probe=64, explorer=explorer)
    expected = {(4, False): acted, (128, False): looked, (128, True): learned}
    assert counts(work.collecting(config)) == {key: 1000 * count for key, count in expected.items() if count}


@pytest.mark.parametrize(
    ("model", "learned", "looked"), [("curl", 1, 1 + 2 * 4 / 100), ("icm", 2, 2 * 4 / 100), ("rnd", 1, 1 + 2 * 4 / 100)]
)
def test_encoders_count_batches_and_what_is_held_out(model: str, learned: float, looked: float) -> None:
    config = msgspec.convert({"world_model": model, "updates": 400, "batch_size": 128}, EncoderTrainConfig)
    done = work.encoding(config, 20_480)
    assert counts(done) == {(128, True): 51_200 * learned, (128, False): pytest.approx(51_200 * looked)}
    assert done.steps == 20_480 * work.encoding(config, 1).steps


def test_policies_count_whole_rollouts_and_epochs() -> None:
    config = PolicyTrainConfig(steps=4097, num_envs=32, num_steps=128, mean_images=500)
    assert counts(work.learning(config, encoder=False)) == {(32, False): 8192 + 64, (128, True): 4 * 8192}
    assert counts(work.learning(config, encoder=True))[128, False] == 2 * 500
    frozen = msgspec.structs.replace(config, frozen=True, transfer="weights")
    assert counts(work.learning(frozen, encoder=True)) == {(32, False): 8192 + 64}


def test_scoring_counts_every_step_of_the_budget() -> None:
    config = EvaluateConfig()
    policy, random = work.playing(config, NETWORK), work.playing(config, None)
    assert counts(policy) == {(100, False): 10_000}
    assert (random.steps, random.images) == (policy.steps, {})


def test_probes_count_images_by_encoder_and_the_maps_as_images() -> None:
    config = ProbeConfig(train_worlds=1500, validation_worlds=400, test_worlds=800, moves=3, untrained=2, pixels=False)
    maps, seen = 10 * 3 * 15e9 / 17e6, 2700 * 4 * 3
    assert counts(work.probing(config, NETWORK)) == {(128, False): pytest.approx(seen + maps)}
    pixels = 2 * 84 * 84 * 3 * (2 * 1500**2 + 8 * (1500 * 3 / 8) ** 2) / 17e6
    with_pixels = msgspec.structs.replace(config, pixels=True)
    assert counts(work.probing(with_pixels, NETWORK)) == {(128, False): pytest.approx(seen + maps + pixels)}


@pytest.mark.parametrize("more", [2, 10])
def test_more_steps_take_longer_in_proportion(more: int) -> None:
    def seconds(done: Work) -> float:
        return done.seconds(1e-4, lambda how: 1e-3 if how.learn else 2e-4) - Work().seconds(0, lambda _: 0)

    def policy(steps: int) -> float:
        return seconds(work.learning(PolicyTrainConfig(steps=steps), encoder=False))

    first = seconds(work.learning(PolicyTrainConfig(steps=4096), encoder=False)) - (policy(8192) - policy(4096))
    assert policy(4096 * more) - first == pytest.approx(more * (policy(4096) - first))
    short, long = CollectConfig(steps=4096), CollectConfig(steps=4096 * more)
    assert seconds(work.collecting(long)) == pytest.approx(more * seconds(work.collecting(short)))
    for stage in (work.releasing, work.drawing):
        assert stage(long).steps == more * stage(short).steps


def test_what_is_written_grows_with_the_steps_and_with_what_is_logged() -> None:
    short, long = CollectConfig(steps=1_000_000), CollectConfig(steps=2_000_000)
    deep = msgspec.structs.replace(short, log=LogConfig(depth=True))
    assert work.bytes_written(long) - work.bytes_written(short) == 3_000_000_000
    assert work.bytes_written(deep) > work.bytes_written(long)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (3, "less than a minute"), (44, "less than a minute"), (46, "about 1 min"), (230, "about 4 min"),
        (594, "about 10 min"), (20 * 60, "about 20 min"), (23 * 60, "about 25 min"), (80 * 60, "about 80 min"),
        (95 * 60, "about 2 h"), (30 * 3600, "about 30 h"),
    ],
)  # fmt: skip
def test_expected_times_are_no_more_precise_than_they_can_be(seconds: float, words: str) -> None:
    assert work.about(seconds) == words
