"""PPO on a task: repeatable, resumable, right about the ends of episodes."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from gym_open import artefacts, progress, seeding
from gym_open.agents.config import CurlConfig, EncoderConfig, ExplorerConfig, PPOConfig
from gym_open.agents.encoder import Encoder
from gym_open.collect.config import CollectConfig, CurriculumConfig
from gym_open.collect.explore import collect
from gym_open.config import Config
from gym_open.envs.env import OpenEnv
from gym_open.envs.state import state_vector
from gym_open.errors import ArtefactError, ConfigError, DivergedError
from gym_open.formats.models import load_encoder, load_policy
from gym_open.precision import native_precision
from gym_open.progress import bar
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig
from gym_open.train.encoder import train_encoder
from gym_open.train.environments import TrainingEnvironments
from gym_open.train.policy import COLUMNS, _PolicyTrainer, train_policy
from tests.children import killed_at

pytestmark = pytest.mark.learning
NETWORK = EncoderConfig(features=16)
TINY = PolicyTrainConfig(
    steps=40, num_envs=2, num_steps=8, mean_images=3, encoder=NETWORK, threads=1,
    ppo=PPOConfig(minibatch_size=8, update_epochs=1),
)  # fmt: skip


@pytest.fixture(scope="module")
def encoder(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = EncoderTrainConfig(updates=2, batch_size=4, encoder=NETWORK, curl=CurlConfig(latent=4), threads=1)
    return train_encoder(config, release, tmp_path_factory.mktemp("encoder") / "encoder").path


def test_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = (train_policy(TINY, None, tmp_path / name) for name in ("a", "b"))
    assert artefacts.digest(first.path) == artefacts.digest(second.path)
    assert not train_policy(TINY, None, tmp_path / "a").made


def test_payload_curve_and_lineage(tmp_path: Path) -> None:
    path = train_policy(TINY, None, tmp_path / "p").path
    found = json.loads((path / "curve.json").read_text())
    assert found["columns"] == list(COLUMNS)
    assert [row[0] for row in found["rows"]] == [16, 32, 48]  # 40 steps are rounded up to whole rollouts
    record = artefacts.lineage(path)
    assert (record.kind, record.parents) == ("policy", [])
    hardware = record.facts.pop("hardware")
    assert (hardware["threads"], hardware["device"]) == (1, "cpu")
    assert record.facts == {
        "task": "goal-seeking", "steps": 48, "checkpoints": [], "agent": "scratch", "encoder": "none", "transfer": None,
        "frozen": False, "seed": 0, "from_encoder": False,
        "precision": native_precision(),
    }  # fmt: skip
    assert load_policy(path).n_actions == 9


def test_checkpoints_are_the_policy_as_it_was_then(tmp_path: Path) -> None:
    path = train_policy(msgspec.structs.replace(TINY, checkpoints=(17, 20, 48, 1000)), None, tmp_path / "long").path
    kept = [{"asked": 17, "step": 32}, {"asked": 20, "step": 32}, {"asked": 48, "step": 48}]
    assert artefacts.lineage(path).facts["checkpoints"] == kept
    assert sorted(folder.name for folder in (path / "checkpoints").iterdir()) == ["000000032", "000000048"]
    shorter = train_policy(msgspec.structs.replace(TINY, steps=32), None, tmp_path / "short").path
    for folder, same in ((path / "checkpoints/000000032", shorter), (path / "checkpoints/000000048", path)):
        assert (folder / "model.safetensors").read_bytes() == (same / "model.safetensors").read_bytes()
    assert load_policy(path / "checkpoints/000000032").n_actions == 9


def test_state_in_place_of_pictures(tmp_path: Path) -> None:
    config = msgspec.structs.replace(TINY, encoder=EncoderConfig(architecture="state"), trunk=(8,))
    trainer = _PolicyTrainer(config, None, tmp_path)
    with bar("test", 1) as shown:
        rollout, _ = trainer.collect(shown)
    env = OpenEnv("goal-seeking")
    env.reset(seed=seeding.integer(config.seed, "policy", "env", 1))
    for t in range(config.num_steps):
        assert np.array_equal(rollout.obs[t, 1].numpy(), state_vector(env.world))
        env.step(int(rollout.actions[t, 1]))
    assert load_policy(train_policy(config, None, tmp_path / "p").path).encoder.config.architecture == "state"


def test_a_frozen_encoder_stays_and_its_features_are_what_is_learned_from(encoder: Path, tmp_path: Path) -> None:
    config = msgspec.structs.replace(TINY, frozen=True, transfer="weights")
    path = train_policy(config, encoder, tmp_path / "p").path
    start, after = load_encoder(encoder), load_policy(path)
    assert all(torch.equal(a, b) for a, b in zip(after.encoder.parameters(), start.parameters(), strict=True))
    untrained = _PolicyTrainer(config, encoder, tmp_path / "none").agent
    assert not torch.equal(after.actor.weight, untrained.actor.weight)
    assert not any(parameter.requires_grad for parameter in untrained.encoder.parameters())
    assert artefacts.lineage(path).facts["frozen"] is True
    with pytest.raises(ConfigError, match="frozen: true, but there is no encoder"):
        train_policy(config, None, tmp_path / "q")


def test_from_an_explorers_own_encoder(tmp_path: Path) -> None:
    explorer = ExplorerConfig(world_model="icm", reward="error", encoder=NETWORK)
    play = CollectConfig(steps=64, streams=1, rollout=16, pool=2, probe=16, explorer=explorer)
    log = collect(play, tmp_path / "log").path
    barely = msgspec.structs.replace(
        TINY, steps=1, transfer="weights", ppo=PPOConfig(learning_rate=1e-12, minibatch_size=8)
    )
    path = train_policy(barely, log, tmp_path / "p").path
    facts = artefacts.lineage(path).facts
    assert (facts["encoder"], facts["agent"]) == ("online", "icm-weights")
    for a, b in zip(load_policy(path).encoder.parameters(), load_encoder(log).parameters(), strict=True):
        torch.testing.assert_close(a, b, atol=1e-8, rtol=0)
    alone, never = ExplorerConfig(world_model="none", reward="none"), CurriculumConfig(rule="never")
    bare = collect(msgspec.structs.replace(play, explorer=alone, curriculum=never), tmp_path / "bare").path
    with pytest.raises(ArtefactError, match="bare: a log without an encoder"):
        train_policy(barely, bare, tmp_path / "q")


def test_divergence_names_the_update_and_what_to_change(encoder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    config = msgspec.structs.replace(TINY, ppo=PPOConfig(learning_rate=1e20, minibatch_size=8))
    with pytest.raises(DivergedError, match=r"update \d of 3: .* not finite; make `ppo\.learning_rate` \(now 1e\+20\)"):
        train_policy(config, encoder, broken)
    assert not broken.exists()


def test_killed_and_resumed_is_as_if_never_killed(tmp_path: Path) -> None:
    config = msgspec.structs.replace(TINY, steps=16 * 6)
    whole = train_policy(config, None, tmp_path / "whole").path
    cut = tmp_path / "cut"
    settings = msgspec.json.encode(config).decode()
    code = (
        "import msgspec; from pathlib import Path; from gym_open.train.config import PolicyTrainConfig as C; "
        "from gym_open.train.policy import train_policy; "
        f"train_policy(msgspec.json.decode({settings!r}, type=C), None, Path({str(cut)!r}))"
    )
    killed_at(tmp_path / ".cut.partial" / "checkpoint", "state.safetensors", code)
    assert not cut.exists()
    assert artefacts.digest(train_policy(config, None, cut).path) == artefacts.digest(whole)


def test_from_an_encoder_keeps_its_mean_picture_and_starts_at_its_weights(encoder: Path, tmp_path: Path) -> None:
    barely = msgspec.structs.replace(
        TINY, steps=1, transfer="weights", ppo=PPOConfig(learning_rate=1e-12, minibatch_size=8)
    )
    path = train_policy(barely, encoder, tmp_path / "p").path
    start, tuned = load_encoder(encoder), load_policy(path).encoder
    assert isinstance(tuned, Encoder)
    assert torch.equal(tuned.mean_image, start.mean_image)
    for a, b in zip(tuned.parameters(), start.parameters(), strict=True):
        torch.testing.assert_close(a, b, atol=1e-8, rtol=0)
    record = artefacts.lineage(path)
    assert [parent.digest for parent in record.parents] == [artefacts.digest(encoder)]
    assert record.facts["from_encoder"] is True


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"features": 32}, r"`encoder\.features` is 16, but .* 32"),
        ({"pixel_scale": 1.0}, r"`encoder\.pixel_scale` is 20"),
    ],
)
def test_an_encoder_of_another_shape_stops_it_before_any_work(
    encoder: Path, tmp_path: Path, change: dict[str, float], message: str
) -> None:
    network: Config = msgspec.structs.replace(NETWORK, **change)
    with pytest.raises(ArtefactError, match=message):
        train_policy(msgspec.structs.replace(TINY, encoder=network), encoder, tmp_path / "p")
    assert not list(tmp_path.iterdir())


def test_annealing_ends_near_zero(tmp_path: Path) -> None:
    config = msgspec.structs.replace(TINY, ppo=PPOConfig(minibatch_size=8, update_epochs=1, anneal_lr=True))
    rows = json.loads((train_policy(config, None, tmp_path / "p").path / "curve.json").read_text())["rows"]
    np.testing.assert_allclose([row[-1] for row in rows], [5e-4, 5e-4 * 2 / 3, 5e-4 / 3])


def test_rollout_is_what_the_environments_did(tmp_path: Path) -> None:
    """Play the recorded actions again in plain environments; no-ops only, so that episodes reach their budget."""
    config = msgspec.structs.replace(TINY, num_steps=103, ppo=PPOConfig(precision="fp32"))
    trainer = _PolicyTrainer(config, None, tmp_path / "none")
    with torch.no_grad():
        assert isinstance(trainer.agent.actor, torch.nn.Linear)
        trainer.agent.actor.bias[0] = 100.0
    with bar("test", 1) as shown:
        rollout, episodes = trainer.collect(shown)

    def value(image: np.ndarray) -> torch.Tensor:
        with torch.no_grad():
            return trainer.agent.get_value(trainer.agent.encoder.prepare(torch.from_numpy(image)[None]))[0]

    assert rollout.truncations[99].all()
    assert int(rollout.truncations.sum()) == len(episodes) == 2
    assert not rollout.terminations.any()
    assert [(e.total, e.length, e.success) for e in episodes] == [(0.0, 100, False)] * 2
    for n in range(2):
        env = OpenEnv("goal-seeking")
        image, _ = env.reset(seed=seeding.integer(config.seed, "policy", "env", n))
        for t in range(103):
            assert np.array_equal(rollout.obs[t, n].numpy(), image)
            image, reward, terminated, truncated, _ = env.step(int(rollout.actions[t, n]))
            assert rollout.rewards[t, n] == reward
            assert (bool(rollout.terminations[t, n]), bool(rollout.truncations[t, n])) == (terminated, truncated)
            torch.testing.assert_close(rollout.next_values[t, n], value(image))
            if terminated or truncated:
                image, _ = env.reset()


def test_what_a_rollout_goes_on_with_is_seen_after_its_last_step(tmp_path: Path) -> None:
    trainer = _PolicyTrainer(msgspec.structs.replace(TINY, ppo=PPOConfig(precision="fp32")), None, tmp_path / "none")
    with torch.no_grad():
        assert isinstance(trainer.agent.actor, torch.nn.Linear)
        trainer.agent.actor.bias[0] = -100.0  # nothing stands still
    with bar("test", 1) as shown:
        rollout, _ = trainer.collect(shown)
    with torch.no_grad():
        after = trainer.agent.get_value(trainer.agent.encoder.prepare(torch.from_numpy(trainer.environments.seen)))
    torch.testing.assert_close(rollout.next_values[-1], after)
    assert not torch.isclose(rollout.values[-1], after).any()


def random_play(environments: TrainingEnvironments, steps: int) -> list[object]:
    rng, seen = np.random.default_rng(0), []
    for _ in range(steps):
        after = environments.step(rng.integers(9, size=2))
        seen += [after.rewards.tolist(), after.truncations.tolist(), after.episodes, environments.seen.tobytes()]
    return seen


def test_tables_go_on_from_a_snapshot_bit_for_bit() -> None:
    environments = TrainingEnvironments("goal-seeking", 2, seed=0)
    random_play(environments, 60)
    state = json.loads(json.dumps(environments.state()))
    expected = random_play(environments, 60)  # over the end of both episodes
    other = TrainingEnvironments("goal-seeking", 2, seed=5)
    other.restore(state)
    assert random_play(other, 60) == expected


def test_environments_differ_and_follow_the_seed() -> None:
    a, b, c = (
        TrainingEnvironments("goal-seeking", 2, seed=0),
        TrainingEnvironments("goal-seeking", 2, seed=0),
        TrainingEnvironments("goal-seeking", 2, seed=1),
    )
    assert np.array_equal(a.seen, b.seen)
    assert not np.array_equal(a.seen[0], a.seen[1])
    assert not np.array_equal(a.seen, c.seen)


def test_success_is_all_goals_hit() -> None:
    """Avoidance ends in the danger patch, too: that is no success, whatever was paid before."""
    environments = TrainingEnvironments("avoidance", 8, seed=0)
    rng = np.random.default_rng(0)
    episodes = [e for _ in range(150) for e in environments.step(rng.integers(9, size=8)).episodes]
    assert any(e.success for e in episodes)
    assert any(not e.success and e.length < 100 for e in episodes)
    most = max(e.total for e in episodes)
    assert all(e.total == most for e in episodes if e.success)


def test_a_return_that_is_not_known_yet_is_shown_as_a_dash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In these few steps the first episode does not end."""
    notes: list[str] = []
    monkeypatch.setattr(progress.Bar, "advance", lambda *_, note="": notes.append(note))
    train_policy(msgspec.structs.replace(TINY, steps=16), None, tmp_path / "p")
    shown = [note for note in notes if note]
    assert [note.split(" entropy")[0] for note in shown] == ["return –"]
