"""Pull a version of a release from a hub. It appears only after it is verified."""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from gym_open import artefacts, progress
from gym_open.artefacts import MANIFEST, SIGNATURE, Entry
from gym_open.datasets.compare.versions import parse
from gym_open.datasets.hub.client import check_repo, identity, tags, talking, tree, verified, versions
from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.files import lock, sha256_file
from gym_open.formats.compact import layout as compact
from gym_open.formats.releases.layout import INFO_PATH, belongs

if TYPE_CHECKING:
    from huggingface_hub import HfApi
    from huggingface_hub.hf_api import RepoFile

_MAX_UNLISTED = 2**26
"""Largest size in bytes of the manifest and the signature, which no manifest lists."""


def pull_release(repo: str, version: str, out: Path, *, send: bool, endpoint: str | None = None) -> Path:
    """Fetch a version of a release from a hub into `out`. Afterwards `out` is whole and verified, or absent.

    It fetches only the signature and the files in the manifest. An interrupted pull leaves a hidden folder next to
    `out`, from which the next one continues.

    Args:
        repo: OWNER/NAME of the data set.
        version: X.Y.Z; the tag `vX.Y.Z` is fetched.
        out: folder to write. If it exists with the same bytes, nothing is done.
        send: use the network. Without it nothing is fetched.
        endpoint: address of the hub; by default HF_ENDPOINT or huggingface.co.

    Returns:
        `out`, even if (without `send`) nothing was fetched.

    Raises:
        ArtefactError: if there is no such version, or if the files do not match the manifest, are no release, or are
            another release. None of them are kept.
        UsageError: if the name or version is not valid, `out` is something else, or another process is pulling it.
        GymOpenError: if the hub cannot be reached or refuses. The files so far are kept for the next attempt.
    """
    check_repo(repo)
    if parse(version) is None:
        raise UsageError(f"a version must be three numbers, as 1.0.0, got {version!r}")
    if not send:
        return out
    out = out.absolute()
    with talking(repo, endpoint) as api:
        known = tags(api, repo)
        if (commit := known.get(f"v{version}")) is None:
            there = ", ".join("{}.{}.{}".format(*item) for item in versions(known)) or "none"
            raise ArtefactError(f"{repo}: no version {version} there; versions: {there}")
        partial = out.with_name(f".{out.name}.pull.partial")
        out.parent.mkdir(parents=True, exist_ok=True)
        with lock(out):
            try:
                _Pull(api, repo, commit, partial, tree(api, repo, commit)).into(out, version)
            except ArtefactError:
                shutil.rmtree(partial, ignore_errors=True)  # refused: a later pull must start again
                raise
    return out


@contextmanager
def _without_bars() -> Iterator[None]:
    """Hide the client's own progress bars, one per file, which would overwrite ours."""
    from huggingface_hub.utils.tqdm import are_progress_bars_disabled, disable_progress_bars, enable_progress_bars

    if are_progress_bars_disabled():
        yield
        return
    disable_progress_bars()
    try:
        yield
    finally:
        enable_progress_bars()


@dataclass(frozen=True)
class _Pull:
    """Fetches the files of one commit."""

    api: "HfApi"
    repo: str
    commit: str
    folder: Path
    there: "Mapping[str, RepoFile]"
    """The hub's record of its files."""

    def into(self, out: Path, version: str) -> None:
        """Fetch all files, verify them, and rename the folder to `out`."""
        self._unlisted(MANIFEST)
        entries = self._listed()
        if out.exists():
            return self._compare(out)
        needed, free = sum(entry.bytes for entry in entries.values()), shutil.disk_usage(self.folder).free
        if needed > free:
            raise GymOpenError(f"{out}: {needed:,} bytes are needed there, {free:,} are free; make room, or give --out")
        with _without_bars(), progress.bar("dataset pull", needed) as bar:
            info = compact.INFO if compact.INFO in entries else INFO_PATH
            self._listed_file(info, entries[info])
            self._check_identity(version)  # before the other files are fetched
            for name in sorted(entries):
                self._listed_file(name, entries[name])
                bar.advance(entries[name].bytes)
        if SIGNATURE in self.there:
            self._unlisted(SIGNATURE)
        shutil.rmtree(self.folder / ".cache", ignore_errors=True)  # the client's notes for continuing
        verified(self.folder)
        self.folder.rename(out)
        return None

    def _fetch(self, name: str) -> None:
        (self.folder / name).unlink(missing_ok=True)
        self.api.hf_hub_download(
            self.repo, name, repo_type="dataset", revision=self.commit, local_dir=self.folder
        )  # the caller checks the file

    def _unlisted(self, name: str) -> None:
        """Fetch a file that no manifest lists, unless it is too large."""
        if name not in self.there:
            raise ArtefactError(f"{self.repo}: no {name} there: not a release of gym-open")
        if (size := self.there[name].size) > _MAX_UNLISTED:
            raise ArtefactError(f"{self.repo}: {name}: {size:,} bytes are too many for a release of gym-open")
        self._fetch(name)
        if (came := (self.folder / name).stat().st_size) != size:
            raise ArtefactError(f"{self.repo}: {name}: {came:,} bytes came, the hub announced {size:,}; try again")

    def _listed_file(self, name: str, entry: Entry) -> None:
        """Fetch a file, unless an earlier pull fetched it."""
        path = self.folder / name
        if path.is_file() and sha256_file(path) == entry.sha256:
            return
        self._fetch(name)
        if path.stat().st_size != entry.bytes or sha256_file(path) != entry.sha256:
            raise ArtefactError(f"{self.repo}: {name} does not match {MANIFEST}; try again, or another source")

    def _listed(self) -> dict[str, Entry]:
        """Read the manifest, and check that its files belong to a release and have the same sizes on the hub."""
        try:
            entries = msgspec.json.decode((self.folder / MANIFEST).read_bytes(), type=dict[str, Entry])
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ArtefactError(f"{self.repo}: {MANIFEST} is not that of a release: {error}") from None
        allowed = compact.belongs if compact.INFO in entries else belongs
        for name, entry in entries.items():
            if not allowed(name) or name in {MANIFEST, SIGNATURE}:
                raise ArtefactError(f"{self.repo}: {MANIFEST} lists {name!r}, which no release holds; do not trust it")
            found = self.there[name].size if name in self.there else "none"
            if found != entry.bytes:
                raise ArtefactError(f"{self.repo}: {name}: {MANIFEST} says {entry.bytes} bytes, the hub has {found}")
        if not {INFO_PATH, compact.INFO} & entries.keys():
            raise ArtefactError(f"{self.repo}: {MANIFEST} does not list {INFO_PATH}: not a release of gym-open")
        return entries

    def _check_identity(self, version: str) -> None:
        """Check by `info.json` that this is the requested release."""
        name, found = identity(self.folder)
        if name.partition("/")[2] != self.repo.partition("/")[2] or found != version:
            raise ArtefactError(f"{self.repo}: its tag v{version} holds {name} {found}; do not trust this source")

    def _compare(self, out: Path) -> None:
        """Check that the existing `out` has the manifest of the hub."""
        same = sha256_file(self.folder / MANIFEST)
        shutil.rmtree(self.folder)
        if not (out / MANIFEST).is_file() or artefacts.digest(out) != same:
            raise UsageError(f"{out}: exists and is not what the hub has; give another --out or remove it")
        artefacts.verify(out)
