"""Sign releases with a sigstore bundle, `signature.json`, and check it, off-line, with an elliptic-curve key.

The bundle has the format of model-signing, which can also verify it. It covers every file of the release except itself.
"""

import hashlib
import json
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gym_open import artefacts, extras
from gym_open.artefacts import MAX_SIGNATURE_BYTES, SIGNATURE
from gym_open.errors import ArtefactError, UsageError
from gym_open.files import write_atomically

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey
    from model_signing.hashing import Config as Hashing

_MAKE_A_KEY = "make one with: openssl ecparam -name prime256v1 -genkey -noout -out KEY.pem"
_PUBLIC_OF = "its public half is made with: openssl ec -in KEY.pem -pubout -out KEY.pub"


def sign_release(root: Path, key: Path) -> Path:
    """Sign the whole release at `root` and return the path of its signature.

    A valid signature by the same key is kept, because two signatures of the same bytes differ.

    Args:
        root: folder of a release. Every byte of it is checked first.
        key: PEM file of a private key on the curve P-256, P-384 or P-521, without a password.

    Raises:
        ArtefactError: if the release is damaged.
        UsageError: if the key is missing or has another type.
        MissingExtraError: if model-signing is not installed.
    """
    signing, hashing = _library()
    artefacts.verify(root, "release")
    public = _load(key, private=True)
    with tempfile.TemporaryDirectory() as folder:
        pem, bundle = Path(folder) / "key.pub", Path(folder) / SIGNATURE
        pem.write_bytes(_pem(public))
        with suppress(ArtefactError):
            check_signature(root, pem)
            return root / SIGNATURE
        config = signing.signing.Config().use_elliptic_key_signer(private_key=key)
        config.set_hashing_config(hashing).sign(root.resolve(), bundle)
        write_atomically(root / SIGNATURE, bundle.read_bytes())
    return root / SIGNATURE


def check_signature(root: Path, key: Path | None) -> str:
    """Return one line about who signed the release at `root`. With `key`, check the signature against every byte.

    Args:
        root: folder of a release.
        key: PEM file of the signer's public key. Without it nothing is checked.

    Raises:
        ArtefactError: if there is a key and no signature, the signature belongs to another key or other bytes, or it
            is no sigstore bundle.
        UsageError: if the key is missing or has another type.
        MissingExtraError: if there is a key and model-signing is not installed.
    """
    path = root / SIGNATURE
    if path.is_file() and path.stat().st_size > MAX_SIGNATURE_BYTES:
        raise ArtefactError(f"{path}: over {MAX_SIGNATURE_BYTES:,} bytes, more than any signature; download it again")
    if key is None:
        return f"signed by {_hint(path)}, not checked: give --key" if path.exists() else "not signed"
    signing, hashing = _library()
    fingerprint = _fingerprint(_load(key, private=False))
    if not path.is_file():
        raise ArtefactError(f"{path}: missing: the release is not signed, but --key asks for a signature")
    if (hint := _hint(path)) != fingerprint:
        raise ArtefactError(f"{path}: signed by the key {hint}, not by {key} ({fingerprint}); is it the signer's key?")
    try:
        config = signing.verifying.Config().set_hashing_config(hashing).use_elliptic_key_verifier(public_key=key)
        config.verify(root.resolve(), path)
        _check_whole(root, path)
    except Exception as error:  # a hostile bundle can make parsers raise anything
        what = str(error) or type(error).__name__
        raise ArtefactError(f"{path}: is not valid for this release: {what}; get it again from its source") from None
    return f"signed by the key {fingerprint}"


def _library() -> "tuple[Any, Hashing]":
    extras.check("sign")
    import model_signing

    hashing = model_signing.hashing.Config().set_ignored_paths(paths=[SIGNATURE], ignore_git_paths=False)
    return model_signing, hashing


def _load(key: Path, *, private: bool) -> "EllipticCurvePublicKey":
    """Load the public key in `key`, or the public half of a private key."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    try:
        data = key.read_bytes()
    except OSError as error:
        raise UsageError(f"{key}: cannot be read ({error.strerror}); {_MAKE_A_KEY}") from None
    wanted = "a private key" if private else "a public key"
    remedy = _MAKE_A_KEY if private else _PUBLIC_OF
    try:
        if private:
            found: Any = serialization.load_pem_private_key(data, password=None).public_key()
        else:
            found = serialization.load_pem_public_key(data)
    except TypeError:
        raise UsageError(f"{key}: has a password; give one without: openssl ec -in KEY.pem -out PLAIN.pem") from None
    except Exception:  # cryptography raises different exceptions for each format
        raise UsageError(f"{key}: not {wanted} in PEM form; {remedy}") from None
    if not (isinstance(found, ec.EllipticCurvePublicKey) and found.key_size in {256, 384, 521}):
        raise UsageError(f"{key}: must be {wanted} on the curve P-256, P-384 or P-521; {remedy}")
    return found


def _pem(key: "EllipticCurvePublicKey") -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def _fingerprint(key: "EllipticCurvePublicKey") -> str:
    """SHA-256 of the public key in PEM form, which model-signing calls the hint of the key."""
    return hashlib.sha256(_pem(key)).hexdigest()


def _hint(path: Path) -> str:
    """The key that a bundle claims; nothing proves it."""
    try:
        hint = json.loads(path.read_bytes())["verificationMaterial"]["publicKey"]["hint"]
        bytes.fromhex(hint)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise ArtefactError(f"{path}: not a sigstore bundle that names its key; sign the release again") from None
    return hint


def _check_whole(root: Path, path: Path) -> None:
    """Check what model-signing does not: parts of the bundle that it ignores, and files that a signer left out.

    Raises:
        ValueError: if the bundle is not the canonical encoding of its content, or covers too few files.
    """
    from sigstore_models.bundle.v1 import Bundle

    data = path.read_bytes()
    bundle = Bundle.from_json(data)
    envelope = bundle.dsse_envelope
    if envelope is None or bundle.to_json().encode() != data:
        raise ValueError("the bundle holds bytes that are not signed")
    if [item.keyid for item in envelope.signatures] != [""] or bundle.verification_material.tlog_entries:
        raise ValueError("the bundle holds fields that are not signed")
    covered = {item["name"] for item in json.loads(envelope.payload)["predicate"]["resources"]}
    present = {item.relative_to(root).as_posix() for item in root.rglob("*") if item.is_file()} - {SIGNATURE}
    if covered != present:
        raise ValueError(f"the signature leaves out {', '.join(sorted(present - covered))}")
