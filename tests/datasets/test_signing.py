"""A signature covers every byte of a release; model-signing itself accepts it, and nothing that was changed."""

import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import model_signing
import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from gym_open import artefacts
from gym_open.config import Config
from gym_open.datasets.signing import check_signature, sign_release
from gym_open.errors import ArtefactError, UsageError
from tests.children import run


class Keys(NamedTuple):
    private: Path
    public: Path


def make_keys(folder: Path, name: str, private: ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey) -> Keys:
    keys = Keys(folder / f"{name}.pem", folder / f"{name}.pub")
    keys.private.write_bytes(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    keys.public.write_bytes(private.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return keys


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Keys:
    return make_keys(tmp_path_factory.mktemp("keys"), "key", ec.generate_private_key(ec.SECP256R1()))


@pytest.fixture(scope="module")
def unsigned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a release, signing knows the files alone."""

    def work(folder: Path) -> dict[str, int]:
        (folder / "data").mkdir()
        (folder / "data/file-000.parquet").write_bytes(np.random.default_rng(0).bytes(5000))
        (folder / "README.md").write_text("a card\n")
        return {}

    out = tmp_path_factory.mktemp("release") / "1.0.0"
    return artefacts.build(out, kind="release", config=Config(), parents=[], work=work).path


@pytest.fixture(scope="module")
def signed(unsigned: Path, keys: Keys, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = Path(shutil.copytree(unsigned, tmp_path_factory.mktemp("signed") / "1.0.0"))
    assert sign_release(root, keys.private) == root / "signature.json"
    return root


@pytest.fixture
def copy(signed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(signed, tmp_path / "1.0.0"))


def test_a_signature_leaves_the_digest_and_says_whose_it_is(unsigned: Path, signed: Path, keys: Keys) -> None:
    assert artefacts.verify(signed, "release") == artefacts.digest(unsigned)
    line = check_signature(signed, keys.public)
    assert line.startswith("signed by the key ")
    fingerprint = line.rpartition(" ")[2]
    assert check_signature(signed, None) == f"signed by {fingerprint}, not checked: give --key"
    assert check_signature(unsigned, None) == "not signed"


def test_signing_again_keeps_a_signature_that_holds(copy: Path, keys: Keys) -> None:
    before = (copy / "signature.json").read_bytes()
    sign_release(copy, keys.private)
    assert (copy / "signature.json").read_bytes() == before
    (copy / "signature.json").write_bytes(b"{}")
    sign_release(copy, keys.private)
    check_signature(copy, keys.public)


@pytest.mark.parametrize("curve", [ec.SECP384R1(), ec.SECP521R1()])
def test_stronger_curves_work(unsigned: Path, tmp_path: Path, curve: ec.EllipticCurve) -> None:
    root = Path(shutil.copytree(unsigned, tmp_path / "1.0.0"))
    keys = make_keys(tmp_path, "strong", ec.generate_private_key(curve))
    sign_release(root, keys.private)
    check_signature(root, keys.public)


def test_model_signings_own_command_accepts_it_and_ours_accepts_its(
    copy: Path, unsigned: Path, keys: Keys, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "model_signing", "verify", "key", str(copy)]
    options = ["--signature", str(copy / "signature.json"), "--public_key", str(keys.public)]
    done = run([*command, *options])
    assert (done.returncode, "succeeded" in done.stdout) == (0, True), done.stderr
    other = Path(shutil.copytree(unsigned, tmp_path / "other"))
    ignored = model_signing.hashing.Config().set_ignored_paths(paths=[other / "signature.json"])
    config = model_signing.signing.Config().use_elliptic_key_signer(private_key=keys.private)
    config.set_hashing_config(ignored).sign(other, other / "signature.json")
    check_signature(other, keys.public)


def test_every_flipped_byte_is_caught(copy: Path, keys: Keys) -> None:
    rng = np.random.default_rng(5)
    files = [item for item in sorted(copy.rglob("*")) if item.is_file()]
    for i in range(60):
        path = copy / "signature.json" if i % 2 else files[rng.integers(len(files))]
        good = path.read_bytes()
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        path.write_bytes(bad)
        with pytest.raises(ArtefactError, match=r"signature\.json"):
            check_signature(copy, keys.public)
        path.write_bytes(good)
    check_signature(copy, keys.public)


def test_files_added_or_taken_away_are_caught(copy: Path, keys: Keys) -> None:
    (copy / ".gitattributes").write_text("stray\n")
    with pytest.raises(ArtefactError, match="gitattributes"):
        check_signature(copy, keys.public)
    (copy / ".gitattributes").unlink()
    (copy / "README.md").unlink()
    with pytest.raises(ArtefactError, match=r"README\.md"):
        check_signature(copy, keys.public)


def test_a_signer_who_left_out_files_is_caught(copy: Path, keys: Keys) -> None:
    ignored = model_signing.hashing.Config().set_ignored_paths(paths=["signature.json", "data"])
    config = model_signing.signing.Config().use_elliptic_key_signer(private_key=keys.private)
    config.set_hashing_config(ignored).sign(copy, copy / "signature.json")
    with pytest.raises(ArtefactError, match=r"leaves out data/file-000\.parquet"):
        check_signature(copy, keys.public)


def test_another_key_and_no_signature_are_refused(signed: Path, unsigned: Path, keys: Keys, tmp_path: Path) -> None:
    other = make_keys(tmp_path, "other", ec.generate_private_key(ec.SECP256R1()))
    with pytest.raises(ArtefactError, match="not by"):
        check_signature(signed, other.public)
    with pytest.raises(ArtefactError, match="not signed"):
        check_signature(unsigned, keys.public)


def test_keys_of_no_use_are_named(unsigned: Path, keys: Keys, tmp_path: Path) -> None:
    rsa_keys = make_keys(tmp_path, "rsa", rsa.generate_private_key(65537, 2048))
    locked = tmp_path / "locked.pem"
    key = ec.generate_private_key(ec.SECP256R1())
    locked.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"word")))
    cases = [(keys.public, "not a private key"), (rsa_keys.private, "curve"), (locked, "password"),
             (tmp_path / "none.pem", r"cannot be read \(No such file")]  # fmt: skip
    for path, what in cases:
        with pytest.raises(UsageError, match=what):
            sign_release(unsigned, path)
    for path, what in [(keys.private, "not a public key"), (rsa_keys.public, "curve")]:
        with pytest.raises(UsageError, match=what):
            check_signature(unsigned, path)
    assert not (unsigned / "signature.json").exists()


def test_a_damaged_release_is_not_signed(copy: Path, keys: Keys) -> None:
    (copy / "signature.json").unlink()
    (copy / "README.md").write_text("a cart\n")
    with pytest.raises(ArtefactError, match=r"README\.md"):
        sign_release(copy, keys.private)
    assert not (copy / "signature.json").exists()


def test_a_signature_of_gigabytes_is_refused_unread(unsigned: Path, keys: Keys, tmp_path: Path) -> None:
    root = Path(shutil.copytree(unsigned, tmp_path / "1.0.0"))
    with (root / "signature.json").open("wb") as file:
        file.truncate(3 * 2**30)  # sparse: it takes no space, but would take memory
    for key in (None, keys.public):
        with pytest.raises(ArtefactError, match=r"signature\.json: over 1,048,576 bytes"):
            check_signature(root, key)
    with pytest.raises(ArtefactError, match=r"signature\.json: 3,221,225,472 bytes"):
        sign_release(root, keys.private)
