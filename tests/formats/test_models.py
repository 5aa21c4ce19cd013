"""Encoders and policies on disk, and errors for files that do not fit together."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from gym_open import artefacts
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.policy import ActorCritic
from gym_open.config import Config
from gym_open.errors import ArtefactError
from gym_open.formats.checkpoints import load_checkpoint, save_checkpoint
from gym_open.formats.models import load_encoder, load_policy, save_encoder, save_policy


def encoder() -> Encoder:
    net = Encoder(EncoderConfig(features=8, pixel_scale=3.0), torch.Generator().manual_seed(0))
    net.set_mean_image(torch.full((2, 84, 84, 3), 100, dtype=torch.uint8))
    return net


def policy() -> ActorCritic:
    return ActorCritic(encoder(), 9, torch.Generator().manual_seed(1))


def images() -> torch.Tensor:
    generator = torch.Generator().manual_seed(2)
    return torch.randint(256, (3, 84, 84, 3), generator=generator).to(torch.uint8)


def test_encoder_comes_back_bit_for_bit(tmp_path: Path) -> None:
    net = encoder()
    save_encoder(tmp_path, net)
    found = load_encoder(tmp_path)
    assert found.config == net.config
    assert torch.equal(found(found.prepare(images())), net(net.prepare(images())))


def test_a_logs_encoder_is_found_in_it(tmp_path: Path) -> None:
    save_encoder(tmp_path / "encoder", encoder())
    assert torch.equal(load_encoder(tmp_path).encode(images()), encoder().encode(images()))


def test_policy_comes_back_bit_for_bit(tmp_path: Path) -> None:
    net = policy()
    save_policy(tmp_path, net)
    found = load_policy(tmp_path)
    for a, b in zip(found(found.encoder.prepare(images())), net(net.encoder.prepare(images())), strict=True):
        assert torch.equal(a, b)


def test_equal_models_give_equal_bytes(tmp_path: Path) -> None:
    save_policy(tmp_path / "a", policy())
    save_policy(tmp_path / "b", policy())
    for name in ("model.safetensors", "model.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_wrong_shape_is_named(tmp_path: Path) -> None:
    save_encoder(tmp_path, encoder())
    path = tmp_path / "model.json"
    path.write_text(path.read_text().replace("8", "16"))
    with pytest.raises(ArtefactError, match=r"model\.safetensors.*layers\.7\.bias.*\(16,\).*got \(8,\)"):
        load_encoder(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"), [("missing", "'mean_image' is missing"), ("unknown", "'odd' is unknown")]
)
def test_missing_and_unknown_tensors_are_named(tmp_path: Path, change: str, message: str) -> None:
    save_encoder(tmp_path, encoder())
    tensors, meta = load_checkpoint(tmp_path / "model.safetensors")
    if change == "missing":
        del tensors["mean_image"]
    else:
        tensors["odd"] = torch.zeros(1)
    save_checkpoint(tmp_path / "model.safetensors", tensors, meta)
    with pytest.raises(ArtefactError, match=message):
        load_encoder(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "", "{}", "[1", '{"kind": "encoder", "encoder": {"features": 0}}',
        '{"kind": "encoder", "encoder": {"architecture": "state"}}',
    ],
)  # fmt: skip
def test_a_damaged_architecture_is_named(tmp_path: Path, text: str) -> None:
    save_encoder(tmp_path, encoder())
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(ArtefactError, match=r"model\.json: not an encoder as gym-open writes it"):
        load_encoder(tmp_path)


def test_no_model_at_all(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"model\.json: missing"):
        load_policy(tmp_path)


def test_a_folder_with_another_kind_of_model_is_named(tmp_path: Path) -> None:
    save_policy(tmp_path / "policy", policy())
    save_encoder(tmp_path / "encoder", encoder())
    (tmp_path / "policy/file").write_text("")
    with pytest.raises(ArtefactError, match=r"/policy: a policy, not an encoder; give the folder of an encoder"):
        load_encoder(tmp_path / "policy")
    with pytest.raises(ArtefactError, match=r"/encoder: an encoder, not a policy; give the folder of a policy"):
        load_policy(tmp_path / "encoder")
    for nowhere in ("nowhere", "policy/file", "policy/file/deeper"):
        with pytest.raises(ArtefactError, match=f"{nowhere}: no such folder"):
            load_encoder(tmp_path / nowhere)
    (tmp_path / "encoder/model.json").write_text('{"kind": "something new"}')
    with pytest.raises(ArtefactError, match=r"model\.json: not an encoder as gym-open writes it"):
        load_encoder(tmp_path / "encoder")


def test_the_log_of_a_random_explorer_has_no_encoder(tmp_path: Path) -> None:
    log = artefacts.build(tmp_path / "log", kind="log", config=Config(), parents=(), work=lambda _: {}).path
    with pytest.raises(ArtefactError, match=r"/log: a log without an encoder.*random explorer"):
        load_encoder(log)
    other = artefacts.build(tmp_path / "toy", kind="toy", config=Config(), parents=(), work=lambda _: {}).path
    with pytest.raises(ArtefactError, match=r"model\.json: missing, so there is no model here"):
        load_encoder(other)


def test_a_network_too_wide_is_refused_before_it_is_made(tmp_path: Path) -> None:
    save_encoder(tmp_path, encoder())
    path = tmp_path / "model.json"
    said = json.loads(path.read_bytes())
    said["encoder"]["features"] = 10**9
    path.write_text(json.dumps(said))
    with pytest.raises(ArtefactError, match=r"model\.json: not an encoder .*<= 16384"):
        load_encoder(tmp_path)


def _broken(folder: Path, change: str) -> Path:
    save_encoder(folder, encoder())
    tensors, _ = load_checkpoint(folder / "model.safetensors")
    name = next(name for name, tensor in tensors.items() if tensor.is_floating_point())
    if change == "not finite":
        tensors[name] = torch.full_like(tensors[name], float("nan"))
        save_checkpoint(folder / "model.safetensors", tensors, {})
    elif change == "int64":
        tensors[name] = tensors[name].to(torch.int64)
        save_checkpoint(folder / "model.safetensors", tensors, {})
    elif change == "metadata":
        save_file(tensors, folder / "model.safetensors", metadata={"gym_open": "{not json"})
    elif change == "nested metadata":
        save_file(tensors, folder / "model.safetensors", metadata={"gym_open": "[" * 50_000})
    elif change == "nested":
        (folder / "model.json").write_text("[" * 50_000)
    else:
        (folder / "model.json").write_bytes(b"\xff")
    return folder


@pytest.mark.parametrize("change", ["not finite", "int64", "metadata", "nested metadata", "nested", "bytes"])
def test_hostile_models_are_refused(tmp_path: Path, change: str) -> None:
    with pytest.raises(ArtefactError, match=r"model\.(json|safetensors)"):
        load_encoder(_broken(tmp_path, change))
