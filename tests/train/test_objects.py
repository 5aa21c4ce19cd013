"""Objects from a release, and policies from them: repeatable, and plain about what does not fit."""

from pathlib import Path
from typing import Literal

import msgspec
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.config import EncoderConfig, PPOConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.objects.encoders import ObjectEncoder, SlotEncoder
from gym_open.agents.policy import ActorCritic
from gym_open.agents.symmetry import ACTIONS
from gym_open.config import decode, load
from gym_open.errors import ArtefactError, ConfigError
from gym_open.formats.models import load_encoder, load_policy, save_encoder
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig
from gym_open.train.encoder import train_encoder
from gym_open.train.hub import HubEncoder
from gym_open.train.policy import train_policy
from tests.children import killed_at

pytestmark = pytest.mark.learning
ROOT = Path(__file__).parents[2]
Kind = Literal["slots", "keypoints"]


def encoder_config(architecture: Kind) -> EncoderTrainConfig:
    encoder = EncoderConfig(architecture=architecture, slots=3, readout="centroids", frame="image")
    return EncoderTrainConfig(
        world_model="objects", updates=4, batch_size=8, report_every=2, encoder=encoder, threads=1
    )


def policy_config(encoder: EncoderConfig) -> PolicyTrainConfig:
    ppo = PPOConfig(minibatch_size=32, update_epochs=1, shift_pad=0, precision="fp32")
    return PolicyTrainConfig(
        steps=64,
        num_envs=4,
        num_steps=8,
        checkpoints=(),
        trunk=(16, 8),
        frozen=True,
        encoder=encoder,
        ppo=ppo,
        threads=1,
    )


@pytest.mark.parametrize("architecture", ["slots", "keypoints"])
def test_from_release_to_policy_each_step_repeats_to_the_byte(
    architecture: Kind, release: Path, tmp_path: Path
) -> None:
    config = encoder_config(architecture)
    made = [train_encoder(config, release, tmp_path / name).path for name in ("a", "b")]
    assert artefacts.digest(made[0]) == artefacts.digest(made[1])
    encoder = load_encoder(made[0])
    assert isinstance(encoder, ObjectEncoder)
    policies = [train_policy(policy_config(config.encoder), one, tmp_path / f"policy-{one.name}").path for one in made]
    assert artefacts.digest(policies[0]) == artefacts.digest(policies[1])
    policy = load_policy(policies[0])
    images = torch.randint(0, 256, (3, 84, 84, 3), dtype=torch.uint8)
    features = encoder.encode(images)
    assert features.shape == (3, config.encoder.width) == (3, 13)
    with torch.no_grad():  # training has not changed the encoder, and loading brings the trunk back
        torch.testing.assert_close(policy(policy.prepare(images))[0], policy.heads(features)[0])
    assert [layer.out_features for layer in policy.trunk if isinstance(layer, torch.nn.Linear)] == [16, 8]


@pytest.mark.parametrize("architecture", ["slots", "keypoints"])
def test_a_killed_training_ends_with_the_same_bytes(architecture: Kind, release: Path, tmp_path: Path) -> None:
    config = encoder_config(architecture)
    (tmp_path / "config.json").write_bytes(msgspec.json.encode(config))
    train = (
        "import msgspec; from pathlib import Path; from gym_open.train.config import EncoderTrainConfig; "
        "from gym_open.train.encoder import train_encoder; at = Path(sys.argv[1]); "
        "config = msgspec.json.decode((at / 'config.json').read_bytes(), type=EncoderTrainConfig); "
        "train_encoder(config, Path(sys.argv[2]), at / 'e')"
    )
    killed_at(tmp_path / ".e.partial" / artefacts.SCRATCH, "state.safetensors", train, tmp_path, release)
    whole = train_encoder(config, release, tmp_path / "whole").path
    assert artefacts.digest(train_encoder(config, release, tmp_path / "e").path) == artefacts.digest(whole)


def test_moves_that_show_no_table_end_the_training_in_words(release: Path, tmp_path: Path) -> None:
    """36 frames are too few."""
    config = encoder_config("slots")
    encoder = msgspec.structs.replace(config.encoder, frame="table")
    with pytest.raises(ArtefactError, match=r"do not agree on one table; train longer .*`encoder.frame` image"):
        train_encoder(msgspec.structs.replace(config, encoder=encoder), release, tmp_path / "e")
    assert not (tmp_path / "e").exists()


def test_a_symmetric_policy_repeats_to_the_byte_and_loads_as_it_was(tmp_path: Path) -> None:
    config = EncoderConfig(architecture="slots", slots=3, readout="centroids")
    encoder = SlotEncoder(config, torch.Generator())
    encoder.set_mean_image(torch.zeros(1, 84, 84, 3, dtype=torch.uint8))
    encoder.colours.copy_(torch.tensor([[10.0, 0, 0], [0, 10, 0], [0, 0, 10]]))

    def work(folder: Path) -> dict[str, str]:
        save_encoder(folder, encoder)
        return {"world_model": "objects"}

    source = artefacts.build(tmp_path / "e", kind="encoder", config=encoder_config("slots"), parents=[], work=work).path
    wanted = msgspec.structs.replace(policy_config(config), symmetric=True)
    paths = [train_policy(wanted, source, tmp_path / name).path for name in ("a", "b")]
    assert artefacts.digest(paths[0]) == artefacts.digest(paths[1])
    policy = load_policy(paths[0])
    assert policy.symmetric
    assert policy.encoder.turns is not None
    turned, sign = policy.encoder.turns
    features = torch.randn(4, config.width)
    with torch.no_grad():
        logits, values = policy.heads(features)
        other, same = policy.heads(features[:, turned[5]] * sign[5])
    torch.testing.assert_close(same, values, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(other[:, ACTIONS[5]], logits, rtol=1e-4, atol=1e-5)
    start = ActorCritic(encoder, 9, torch.Generator().manual_seed(0), trunk=(16, 8), symmetric=True)
    assert logits.std() > 0
    assert policy.state_dict().keys() == start.state_dict().keys()


def test_the_configurations_fit_each_other() -> None:
    encoder = load(ROOT / "train/encoder-objects.toml", EncoderTrainConfig)
    assert load(ROOT / "train/policy-objects.toml", PolicyTrainConfig).encoder == encoder.encoder


@pytest.mark.parametrize(
    ("kind", "data", "message"),
    [
        (PolicyTrainConfig, {"encoder": {"architecture": "slots"}}, "`frozen` must be true"),
        (PolicyTrainConfig, {"symmetric": True, "trunk": [8]}, "`symmetric` needs features that are places on the"),
        (PolicyTrainConfig, {"symmetric": True, "encoder": {"architecture": "state"}, "trunk": [12]}, "multiples of 8"),
        (PolicyTrainConfig, {"encoder": {"architecture": "state"}}, "`trunk` needs a layer"),
        (EncoderTrainConfig, {"world_model": "objects"}, "needs `encoder.architecture` slots or keypoints"),
        (EncoderTrainConfig, {"encoder": {"architecture": "slots"}}, "needs `encoder.architecture` slots or keypoints"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(kind: type, data: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        decode(data, kind, source="test")


def test_it_travels_by_a_hub(release: Path, tmp_path: Path) -> None:
    made = train_encoder(encoder_config("slots"), release, tmp_path / "e").path
    HubEncoder.of(made).save_pretrained(tmp_path / "kept")
    images = torch.randint(0, 256, (3, 84, 84, 3), dtype=torch.uint8)
    found = HubEncoder.from_pretrained(tmp_path / "kept")
    assert torch.equal(found.encode(images), load_encoder(made).encode(images))
    assert "13 features" in str(found.generate_model_card())


def test_the_encoder_can_learn_more_slowly_than_the_heads(tmp_path: Path) -> None:
    cnn = EncoderConfig(features=8)
    config = msgspec.structs.replace(policy_config(cnn), frozen=False, encoder_learning_rate=1e-9)
    slow = load_policy(train_policy(config, None, tmp_path / "slow").path)
    longer = msgspec.structs.replace(config, steps=128)
    later = load_policy(train_policy(longer, None, tmp_path / "later").path)
    assert isinstance(slow.encoder, Encoder)
    assert isinstance(later.encoder, Encoder)
    moved = [
        max(float((a - b).detach().abs().max()) for a, b in zip(one.parameters(), other.parameters(), strict=True))
        for one, other in ((slow.encoder, later.encoder), (slow.trunk, later.trunk))
    ]
    assert moved[0] < 1e-6 < moved[1]
