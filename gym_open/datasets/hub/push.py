"""Push a verified release to a hub, tagged with its version."""

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from gym_open.artefacts import MANIFEST, SIGNATURE, Entry
from gym_open.datasets.compare.versions import parse
from gym_open.datasets.hub.client import check_repo, info_path, tags, talking, tree, verified, versions
from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.files import sha256_file
from gym_open.formats.releases.layout import CODEBASE_VERSION, INFO_PATH

if TYPE_CHECKING:
    from huggingface_hub import HfApi

_KEPT_BY_HUB = ".gitattributes"
"""The hub's own file, which lists the files in separate storage."""


def push_release(root: Path, repo: str, *, send: bool, endpoint: str | None = None) -> list[str]:
    """Send exactly the files of the release at `root` to a data set of a hub, and tag them with the version.

    The files of the previous version are deleted there; its tag keeps them. LeRobot looks for the tag `v3.0` (the
    version of its layout), which is moved to the newest release. A version that exists there with the same bytes is
    left unchanged, so that an interrupted push can be repeated.

    Args:
        root: folder of a release. It is verified first.
        repo: OWNER/NAME of the data set; it is created if it is missing. NAME must be that of the release.
        send: use the network. Without it nothing is sent.
        endpoint: address of the hub; by default HF_ENDPOINT or huggingface.co. The token is the one that
            `hf auth login` stored, or HF_TOKEN.

    Returns:
        The files that were sent, or would be sent, one per line.

    Raises:
        ArtefactError: if the release does not verify, or the hub has the version with other bytes.
        UsageError: if the repository has another name than the release, or already has a higher version.
        GymOpenError: if the hub cannot be reached, or refuses.
    """
    name, version = verified(root)
    check_repo(repo, name)
    entries = _entries(root)
    plan = [f"{entry.bytes:>13,}  {file}" for file, entry in sorted(entries.items())]
    marks = f"tags v{version} and {CODEBASE_VERSION}" if info_path(root) == INFO_PATH else f"compact, tag v{version}"
    plan.append(f"{name} {version} to {repo}, {marks}")
    if not send:
        return plan
    with talking(repo, endpoint) as api:
        api.create_repo(repo, repo_type="dataset", exist_ok=True)
        known = tags(api, repo)
        commit = known.get(f"v{version}")
        if commit is not None:
            plan = [f"{repo}: v{version} is there already with the same bytes; nothing was sent"]
            if wrong := _differences(api, repo, commit, root, entries):
                raise ArtefactError(
                    f"{repo}: v{version} is published with other bytes ({wrong[0]}); a published version is never "
                    "changed: give the release a higher version, or another repository"
                )
        else:
            if known and versions({**known, f"v{version}": ""})[-1] != parse(version):
                raise UsageError(
                    f"{repo}: a version above {version} is there already; push versions in ascending order"
                )
            commit = _upload(api, repo, root, entries, f"{name} {version}")
            api.create_tag(repo, tag=f"v{version}", revision=commit, repo_type="dataset")
        if info_path(root) == INFO_PATH:  # LeRobot cannot load a compact release
            _point_lerobot(api, repo, {**known, f"v{version}": commit})
    return plan


def _entries(root: Path) -> dict[str, Entry]:
    """SHA-256 and size of every file of a release, manifest and signature included."""
    found = msgspec.json.decode((root / MANIFEST).read_bytes(), type=dict[str, Entry])
    for path in (root / MANIFEST, root / SIGNATURE):
        if path.is_file():
            found[path.name] = Entry(sha256=sha256_file(path), bytes=path.stat().st_size)
    return found


def _upload(api: "HfApi", repo: str, root: Path, entries: Mapping[str, Entry], title: str) -> str:
    """Make the files of `root` the content of the data set's main branch and return the commit."""
    branches = api.list_repo_refs(repo, repo_type="dataset").branches
    head = next((branch.target_commit for branch in branches if branch.name == "main"), None)
    with _as_default(api.endpoint):
        made = api.upload_folder(
            repo_id=repo, repo_type="dataset", folder_path=root, allow_patterns=sorted(entries), delete_patterns="*",
            commit_message=title, parent_commit=head,
        )  # fmt: skip
    if wrong := _differences(api, repo, made.oid, root, entries):
        raise GymOpenError(
            f"{repo}: the hub did not take {', '.join(wrong[:3])} as sent; nothing was tagged: push again"
        )
    return made.oid


@contextmanager
def _as_default(endpoint: str) -> Iterator[None]:
    """Make `endpoint` the default: for any other endpoint, huggingface_hub 0.35 cannot read the address of a commit."""
    from huggingface_hub import constants

    default, constants.ENDPOINT = constants.ENDPOINT, endpoint
    try:
        yield
    finally:
        constants.ENDPOINT = default


def _differences(api: "HfApi", repo: str, revision: str, root: Path, entries: Mapping[str, Entry]) -> list[str]:
    """Names of the files that differ between a revision on the hub and the release at `root`."""
    from huggingface_hub.utils.sha import git_hash

    there = tree(api, repo, revision)
    there.pop(_KEPT_BY_HUB, None)

    def same(name: str) -> bool:
        remote, entry = there[name], entries[name]
        if remote.lfs is not None:
            return remote.lfs.sha256 == entry.sha256
        data = (root / name).read_bytes()
        return remote.blob_id == git_hash(data) and hashlib.sha256(data).hexdigest() == entry.sha256

    return [name for name in sorted({*there, *entries}) if name not in there or name not in entries or not same(name)]


def _point_lerobot(api: "HfApi", repo: str, known: Mapping[str, str]) -> None:
    """Move the tag by which LeRobot finds a data set to the newest release."""
    newest = known["v{}.{}.{}".format(*versions(known)[-1])]
    if known.get(CODEBASE_VERSION) == newest:
        return
    if CODEBASE_VERSION in known:
        api.delete_tag(repo, tag=CODEBASE_VERSION, repo_type="dataset")
    api.create_tag(repo, tag=CODEBASE_VERSION, revision=newest, repo_type="dataset")
