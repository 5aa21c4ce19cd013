"""Sub-commands that hand releases on: pack, restore, sign, push and pull."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gym_open.cli.base import ArtefactCommand, Command, report, say, say_made, show
from gym_open.cli.datasets import Release
from gym_open.summary import short, word


@dataclass(frozen=True, kw_only=True)
class DatasetPack(ArtefactCommand):
    """Pack a release as its actions, from which every frame is simulated again: less than a byte per step.

    Example: gym-open dataset pack datasets/open/explore/1.0.0
    """

    release: Release
    """Folder of a release."""
    out: Path | None = None
    """Folder of the compact release; default the release's folder with -compact added to its name."""
    workers: int | None = None
    """Threads that check the frames; default one per core."""

    about = "pack a release as its actions"

    def run(self) -> None:
        """Pack the release, and simulate it to check every frame."""
        from gym_open.datasets.compact.overview import compact_table
        from gym_open.datasets.compact.pack import pack_release

        folder = self.out or self.release.with_name(f"{self.release.name}-compact")
        made = pack_release(self.release, folder, workers=self.workers)
        show(compact_table(made.path))
        path = word(made.path)
        report(made, f"gym-open dataset restore {path}", f"gym-open train encoder --release {path}")


@dataclass(frozen=True, kw_only=True)
class DatasetRestore(Command):
    """Make a release again from a compact release: the same bytes, on any x86-64 processor.

    Example: gym-open dataset restore datasets/published/open/play/1.0.0
    """

    compact: Annotated[Path, tyro.conf.Positional]
    """Folder of a compact release."""
    out: Path | None = None
    """Folder of the release; default datasets/NAMESPACE/NAME/VERSION."""
    workers: int | None = None
    """Threads that simulate and encode images; default one per core. The result does not depend on it."""

    about = "make a release again from a compact release"

    def run(self) -> None:
        """Restore the release, and say whether it is the packed one in every byte."""
        from gym_open.datasets.compact.restore import restore_release
        from gym_open.formats.compact import open_compact

        info = open_compact(self.compact).info
        made = restore_release(
            self.compact, self.out or Path("datasets") / info.name / info.version, workers=self.workers
        )
        same = "identical to the packed release in every byte"
        if made.different:
            same = f"the same content; {len(made.different)} files have other bytes, since other packages wrote them"
        say(f"{same} (content digest {info.content[:16]})")
        say_made(made.path, f"gym-open dataset verify {word(made.path)}")


@dataclass(frozen=True, kw_only=True)
class DatasetSign(Command):
    """Sign a release with a private key, without network access. Needs `gym-open[sign]`.

    Example: gym-open dataset sign datasets/open/explore/1.0.0 --key private.pem
    """

    release: Release
    """Folder of a release."""
    key: Path
    """Private key of an elliptic curve (PEM)."""

    about = "sign a release with a key"

    def run(self) -> None:
        """Sign the release."""
        from gym_open.datasets.signing import sign_release

        signature = sign_release(self.release, self.key)
        say_made(signature, f"gym-open dataset verify {word(self.release)} --quick --key PUBLIC_KEY")


@dataclass(frozen=True, kw_only=True)
class DatasetPush(Command):
    """Verify a release, and upload it to a Hugging Face hub with its version as tag. Without --online, print the plan.

    Example: gym-open dataset push datasets/open/explore/1.0.0 --repo me/explore --online
    """

    release: Release
    """Folder of a release."""
    repo: str
    """OWNER/NAME on the hub."""
    online: bool = False
    """Upload it."""
    endpoint: str | None = None
    """Address of the hub; default HF_ENDPOINT, or huggingface.co."""

    about = "upload a release to a Hugging Face hub"

    def run(self) -> None:
        """Upload the release, or print what would be uploaded."""
        from gym_open.datasets.hub import push_release

        for line in push_release(self.release, self.repo, send=self.online, endpoint=self.endpoint):
            say(f"  {line}")
        if not self.online:
            say("nothing was uploaded; add --online to upload it")


@dataclass(frozen=True, kw_only=True)
class DatasetPull(Command):
    """Download a version of a release from a Hugging Face hub and verify it. Without --online, only print the plan.

    Example: gym-open dataset pull me/explore --version 1.0.0 --online
    """

    repo: Annotated[str, tyro.conf.Positional]
    """OWNER/NAME on the hub."""
    version: str
    """Version to download."""
    out: Path | None = None
    """Folder of the release; default datasets/OWNER/NAME/VERSION."""
    online: bool = False
    """Download it."""
    endpoint: str | None = None
    """Address of the hub; default HF_ENDPOINT, or huggingface.co."""

    about = "download a release from a Hugging Face hub and verify it"

    def run(self) -> None:
        """Download the release, or print what would be downloaded."""
        from gym_open.datasets.hub import pull_release

        folder = self.out or Path("datasets") / self.repo / self.version
        path = pull_release(self.repo, self.version, folder, send=self.online, endpoint=self.endpoint)
        if not self.online:
            say(f"would download {self.repo} {self.version} to {short(path)}; add --online to do it")
            return
        say_made(path, f"gym-open dataset verify {word(path)}")
