"""Checkpoints: exact and repeatable; errors name the damage."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from gym_open.errors import ArtefactError
from gym_open.formats.checkpoints import (
    load_checkpoint,
    load_optimizer,
    optimizer_tensors,
    prefixed,
    save_checkpoint,
    without_prefix,
)


def test_tensors_and_meta_come_back_exactly(tmp_path: Path) -> None:
    rng = np.random.Generator(np.random.PCG64(1))
    tensors = {"a": torch.randn(3, 2), "b/c": torch.arange(4), "d": torch.tensor(True), "e": torch.randn(2).bfloat16()}
    meta = {"rng": rng.bit_generator.state, "rows": [[1, 0.1, None]], "x": 1e-320, "text": "×"}
    save_checkpoint(tmp_path / "new" / "state.safetensors", tensors, meta)
    found, found_meta = load_checkpoint(tmp_path / "new" / "state.safetensors")
    assert found.keys() == tensors.keys()
    assert all(torch.equal(found[name], tensors[name]) and found[name].dtype == tensors[name].dtype for name in tensors)
    assert found_meta == meta
    again = np.random.Generator(np.random.PCG64())
    again.bit_generator.state = found_meta["rng"]
    assert again.integers(1 << 60, size=5).tolist() == rng.integers(1 << 60, size=5).tolist()


def test_equal_contents_give_equal_bytes(tmp_path: Path) -> None:
    a, b = torch.randn(3), torch.randn(2)
    save_checkpoint(tmp_path / "1", {"a": a, "b": b}, {"x": 1, "y": 2})
    save_checkpoint(tmp_path / "2", {"b": b, "a": a}, {"y": 2, "x": 1})
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()


def test_shared_and_strided_tensors_are_stored_by_value(tmp_path: Path) -> None:
    weight = torch.randn(4, 3, 2, 2).to(memory_format=torch.channels_last)
    save_checkpoint(tmp_path / "x", {"one": weight, "two": weight, "part": weight[1]}, {})
    found, _ = load_checkpoint(tmp_path / "x")
    assert torch.equal(found["one"], weight)
    assert torch.equal(found["two"], weight)
    assert torch.equal(found["part"], weight[1])


@pytest.mark.parametrize("keep", [0, 5, 60, -1])
def test_a_cut_file_is_named(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "state.safetensors"
    save_checkpoint(path, {"a": torch.randn(8)}, {"x": 1})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ArtefactError, match=r"state\.safetensors: not a whole safetensors file"):
        load_checkpoint(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"state\.safetensors: no such file"):
        load_checkpoint(tmp_path / "state.safetensors")


def test_a_file_of_another_program_is_refused(tmp_path: Path) -> None:
    save_file({"a": torch.zeros(1)}, tmp_path / "theirs.safetensors", metadata={"other": json.dumps({})})
    with pytest.raises(ArtefactError, match="gym-open did not write it"):
        load_checkpoint(tmp_path / "theirs.safetensors")


def network() -> nn.Sequential:
    """The weights of its convolution are in channels-last layout."""
    layers = nn.Sequential(nn.Conv2d(3, 4, 2), nn.Flatten(), nn.Linear(4, 2))
    return layers.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]  (missing in torch's stubs)


def train(net: nn.Sequential, optimizer: torch.optim.Optimizer, steps: int) -> None:
    for _ in range(steps):
        loss = (net(torch.arange(12.0).reshape(1, 3, 2, 2)) ** 2).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


@pytest.mark.parametrize("fused", [False, True])
def test_adam_continues_exactly(tmp_path: Path, *, fused: bool) -> None:
    net = network()
    optimizer = torch.optim.Adam(net.parameters(), lr=0.01, eps=1e-5, fused=fused)
    train(net, optimizer, 3)
    tensors = {**prefixed("net", net.state_dict()), **prefixed("optimizer", optimizer_tensors(optimizer))}
    save_checkpoint(tmp_path / "x", tensors, {})
    train(net, optimizer, 3)

    found, _ = load_checkpoint(tmp_path / "x")
    other = network()
    other.load_state_dict(without_prefix("net", found))
    other_optimizer = torch.optim.Adam(other.parameters(), lr=0.01, eps=1e-5, fused=fused)
    load_optimizer(other_optimizer, without_prefix("optimizer", found))
    train(other, other_optimizer, 3)
    assert all(torch.equal(a, b) for a, b in zip(net.parameters(), other.parameters(), strict=True))


def test_generator_state_comes_back(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(7)
    torch.rand(3, generator=generator)
    save_checkpoint(tmp_path / "x", {"rng": generator.get_state()}, {})
    other = torch.Generator()
    other.set_state(load_checkpoint(tmp_path / "x")[0]["rng"])
    assert torch.equal(torch.rand(5, generator=generator), torch.rand(5, generator=other))
