"""Encoders on a hub: what is sent, that nothing is without being told so, and that it comes back whole."""

import json
import shutil
import socket
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
import torch

from gym_open import artefacts
from gym_open.agents.config import CurlConfig, EncoderConfig
from gym_open.agents.encoder import ImageEncoder
from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.formats.models import load_encoder
from gym_open.train.config import EncoderTrainConfig
from gym_open.train.encoder import train_encoder
from gym_open.train.hub import CARD, HubEncoder, push_encoder

IMAGES = torch.randint(0, 256, (3, 84, 84, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
REPO = "someone/encoder"


@pytest.fixture(scope="module")
def encoder(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = EncoderTrainConfig(
        updates=2, batch_size=4, encoder=EncoderConfig(features=16), curl=CurlConfig(latent=4), threads=1
    )
    return train_encoder(config, release, tmp_path_factory.mktemp("hub") / "encoder").path


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder that stands for a hub's repository: the client's two calls of a push, and its download, end there."""
    there = tmp_path / "hub"

    def upload_folder(_: object, **asked: Any) -> str:
        assert (asked["repo_id"], asked["repo_type"], asked["delete_patterns"]) == (REPO, "model", "*")
        shutil.rmtree(there, ignore_errors=True)
        shutil.copytree(asked["folder_path"], there)
        return "https://hub/commit/1"

    def snapshot_download(repo: str, *, allow_patterns: list[str], **_: object) -> str:
        assert repo == REPO
        assert sorted(allow_patterns) == ["model.json", "model.safetensors"]
        return str(there)

    def create_repo(_: object, *, repo_id: str, private: object, exist_ok: bool) -> object:
        assert exist_ok
        return type("Url", (), {"repo_id": repo_id})

    def hf_hub_download(*, filename: str, **_: object) -> str:
        return str(there / filename)

    monkeypatch.setattr(huggingface_hub.HfApi, "create_repo", create_repo)
    monkeypatch.setattr(huggingface_hub.HfApi, "upload_folder", upload_folder)
    monkeypatch.setattr("gym_open.train.hub.snapshot_download", snapshot_download)
    monkeypatch.setattr("huggingface_hub.hub_mixin.hf_hub_download", hf_hub_download)
    return there


def same(one: ImageEncoder | HubEncoder, other: ImageEncoder | HubEncoder) -> None:
    assert one.config == other.config
    assert torch.equal(one.encode(IMAGES), other.encode(IMAGES))


def test_save_pretrained_and_from_pretrained_round_trip(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    made = HubEncoder(encoder=EncoderConfig(architecture="impala", features=8))
    made.network.set_mean_image(IMAGES)
    made.save_pretrained(tmp_path / "saved")
    same(HubEncoder.from_pretrained(tmp_path / "saved"), made)
    same(load_encoder(tmp_path / "saved"), made)
    assert json.loads((tmp_path / "saved/config.json").read_text())["encoder"]["architecture"] == "impala"
    assert capfd.readouterr() == ("", "")


def test_a_pickle_is_never_read(tmp_path: Path) -> None:
    HubEncoder(encoder=EncoderConfig(features=8)).save_pretrained(tmp_path)
    (tmp_path / "model.safetensors").unlink()
    torch.save({}, tmp_path / "pytorch_model.bin")
    with pytest.raises(ArtefactError, match="no such file"):
        HubEncoder.from_pretrained(tmp_path)


def test_without_online_it_says_what_it_would_send_and_no_socket_is_opened(
    encoder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    *files, last = push_encoder(encoder, REPO, online=False)
    sizes = {line.split()[1]: int(line.split()[0].replace(",", "")) for line in files}
    on_disk = {item.name: item.stat().st_size for item in encoder.iterdir()}
    assert sizes.keys() == {*on_disk, CARD}
    assert on_disk.items() <= sizes.items()
    assert last == f"encoder {artefacts.digest(encoder)[:16]} to {REPO}"


def test_a_push_sends_the_whole_artefact_and_a_card_and_it_loads_from_there(encoder: Path, hub: Path) -> None:
    planned = push_encoder(encoder, REPO, online=False)[:-1]
    sent = push_encoder(encoder, REPO, online=True)
    assert sent == [*planned, "sent to https://hub/commit/1"]
    assert f"{(hub / CARD).stat().st_size:,}  {CARD}" in sent[-2]
    same(HubEncoder.from_pretrained(REPO), load_encoder(encoder))
    card = (hub / CARD).read_text()
    assert huggingface_hub.ModelCard(card).data.to_dict()["license"] == "mit"
    assert f'from_pretrained("{REPO}")' in card
    parents = artefacts.lineage(encoder).parents
    for digest in (artefacts.digest(encoder), parents[0].digest, parents[0].lineage.parents[0].digest):
        assert digest in card
    (hub / CARD).unlink()
    assert artefacts.verify(hub, "encoder") == artefacts.digest(encoder)


@pytest.mark.parametrize("name", ["encoder", "a/b/c", "../x", "some one/x", "", "/"])
def test_names_that_are_no_repository_are_refused(name: str, encoder: Path) -> None:
    with pytest.raises(UsageError, match="OWNER/NAME"):
        push_encoder(encoder, name, online=False)


def test_a_damaged_encoder_is_not_pushed(encoder: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged"
    shutil.copytree(encoder, damaged)
    (damaged / "curve.json").write_text("{}")
    with pytest.raises(ArtefactError, match=r"curve\.json"):
        push_encoder(damaged, REPO, online=False)


def test_a_hub_that_refuses_is_said_in_a_line(encoder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError("401 Client Error")

    monkeypatch.setattr(huggingface_hub.HfApi, "create_repo", refuse)
    with pytest.raises(GymOpenError, match=r"someone/encoder: nothing was pushed .*401 Client Error.*hf auth login"):
        push_encoder(encoder, REPO, online=True)
