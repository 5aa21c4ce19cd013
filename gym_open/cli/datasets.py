"""Sub-commands on dataset releases: make, check, compare, look at, hand on."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gym_open import artefacts
from gym_open.cli.base import Command, Making, out, report, say
from gym_open.cli.stages import Settings, StageCommand
from gym_open.config import check
from gym_open.datasets.config import FilterConfig, Header, License, MergeConfig, ReleaseConfig
from gym_open.errors import GymOpenError, UsageError
from gym_open.formats.releases.layout import Split
from gym_open.summary import short, word

Release = Annotated[Path, tyro.conf.Positional]
"""Folder of a release."""


@dataclass(frozen=True, kw_only=True)
class DatasetBuild(Making, StageCommand):
    """Turn logs into a versioned LeRobot v3.0 release, frames bit-exact.

    The version must be the one that follows from what has changed since the last; `gym-open dataset diff` says which.

    Example: gym-open dataset build --logs collect/logs/curl-ride collect/logs/icm --version 1.0.0
    """

    settings: Settings[ReleaseConfig]
    logs: tuple[Path, ...]
    """Folders of logs that `gym-open collect` made."""
    out: Path | None = None
    """Folder of the release; default datasets/NAMESPACE/NAME/VERSION."""
    previous: Path | None = None
    """Release to compare with; default the highest lower version beside the new one."""
    append: bool = False
    """Take over the previous release as it is, and add what is in the logs."""
    workers: int | None = None
    """Threads that code pictures; default one a processor. The result is the same."""
    replace: bool = False
    """Set aside what stands at --out if it was made of other inputs, rather than refuse: for drafts."""

    default = "datasets/explore.toml"
    about = "logs to a LeRobot release"

    def run(self) -> None:
        """Build."""
        from gym_open.datasets.build import build_release

        if not self.logs:
            raise UsageError("--logs: expected one folder of logs or more; make one with `gym-open collect`")
        folder = self.place(self.out, f"datasets/{self.settings.name}", self.settings.version)
        made = build_release(
            self.settings, self.logs, folder,
            previous=self.previous, append=self.append, workers=self.workers, replace=self.replace,
        )  # fmt: skip
        _made(made)


@dataclass(frozen=True, kw_only=True)
class DatasetVerify(Command):
    """Check a release: every byte, its structure, its statistics, that others can read it, and that it plays out again.

    Example: gym-open dataset verify datasets/open/explore/1.0.0 --quick
    """

    release: Release
    """Folder of a release."""
    quick: bool = False
    """Leave out the replay, in which every action is simulated again and every pixel compared."""
    tolerance: float = 1e-3
    """How far a number (m, m/s, rad/s, N s) may be off in a replay before a window has diverged."""
    key: Path | None = None
    """Public key (PEM) that the release must be signed with."""

    about = "check a release: bytes, structure, statistics, replay"

    def run(self) -> None:
        """Check, print, and fail if anything is wrong."""
        from gym_open.datasets.verify import verify_release

        found = verify_release(self.release, replay=not self.quick, tolerance=self.tolerance, key=self.key)
        for table in found.tables():
            out.print(table)
        say(found.verdict)
        if found.problems:
            raise GymOpenError(f"{short(self.release)}: {len(found.problems)} problem(s), see above")


@dataclass(frozen=True, kw_only=True)
class DatasetDiff(Command):
    """Say what changed between two releases, by file and by meaning, and which version that calls for.

    Example: gym-open dataset diff datasets/open/explore/1.0.0 datasets/open/explore/1.1.0
    """

    one: Release
    """Folder of the earlier release."""
    other: Release
    """Folder of the later one."""

    about = "what changed between two releases"

    def run(self) -> None:
        """Compare and print."""
        from gym_open.datasets.compare.diff import diff_releases, diff_tables
        from gym_open.datasets.compare.versions import implied
        from gym_open.formats.releases import open_release

        one, other = open_release(self.one), open_release(self.other)
        found = diff_releases(one, other)
        for table in diff_tables(found):
            out.print(table)
        if found.bump == "none":
            say("the same release: nothing but version and date may differ")
        else:
            say(f"{found.bump}: after {one.version} comes {implied(one.version, found.bump)}", verb="implied version")


@dataclass(frozen=True, kw_only=True)
class DatasetInfo(Command):
    """Say what is in a release, at a glance.

    Example: gym-open dataset info datasets/open/explore/1.0.0
    """

    release: Release
    """Folder of a release."""

    about = "what is in a release"

    def run(self) -> None:
        """Read and print."""
        from gym_open.datasets.overview import info_tables

        for table in info_tables(self.release):
            out.print(table)
        say(f"  next: gym-open dataset verify {word(self.release)}")


@dataclass(frozen=True, kw_only=True)
class DatasetList(Command):
    """List the releases below a folder.

    Example: gym-open dataset list datasets
    """

    folder: Annotated[Path, tyro.conf.Positional] = Path("datasets")
    """Where to look."""

    about = "the releases below a folder"

    def run(self) -> None:
        """Look and print."""
        from gym_open.datasets.overview import list_table

        out.print(list_table(self.folder))


@dataclass(frozen=True, kw_only=True)
class DatasetExport(Command):
    """Write one split of a release in another form: plain NumPy, or Minari.

    Example: gym-open dataset export datasets/open/explore/1.0.0 --form npz --split train --out train.npz
    """

    release: Release
    """Folder of a release."""
    out: Path
    """File (npz) to write, or folder that Minari's data sets are in."""
    form: Literal["npz", "minari"] = "npz"
    """What to write; Minari needs `gym-open[minari]`."""
    split: str = "train"
    """Split to write."""
    dataset_id: str | None = None
    """What Minari calls the data set, NAMESPACE/NAME-vN; default the release's name, split and major version."""

    about = "a split as NumPy (npz) or Minari"

    def run(self) -> None:
        """Write it."""
        from gym_open.datasets.export import export_minari, export_npz
        from gym_open.formats.releases import open_release

        if self.form == "npz":
            path = export_npz(self.release, self.split, self.out)
        else:
            about = open_release(self.release)
            named = f"{about.name}-{self.split}-v{about.version.split('.')[0]}"
            path = export_minari(self.release, self.split, self.out, self.dataset_id or named)
        say(short(path), verb="made")


@dataclass(frozen=True, kw_only=True)
class _Derived(Making):
    """What a release made of releases is called."""

    name: str
    """NAMESPACE/NAME of the new release."""
    version: str = "1.0.0"
    """Its version."""
    license: License = "mit"
    """Its licence."""
    published: str = ""
    """Its date, YYYY-MM-DD; none if empty."""
    data_file_mb: int = 100
    """A new data file is begun at this size in memory, in MiB."""
    out: Path | None = None
    """Folder of the new release; default datasets/NAMESPACE/NAME/VERSION."""
    workers: int | None = None
    """Threads that code pictures; default one a processor."""

    def _place(self, config: Header) -> Path:
        return self.out or Path("datasets") / config.name / config.version


@dataclass(frozen=True, kw_only=True)
class DatasetMerge(_Derived):
    """Make one release of several, frames copied byte for byte.

    Example: gym-open dataset merge datasets/open/icm/1.0.0 datasets/open/rnd/1.0.0 --name open/both
    """

    releases: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of releases."""

    about = "several releases to one"

    def run(self) -> None:
        """Merge."""
        from gym_open.datasets.merge import merge_releases

        if not self.releases:
            raise UsageError("expected one release or more, got none; give their folders")
        config = MergeConfig(
            name=self.name, version=self.version, license=self.license, published=self.published,
            data_file_mb=self.data_file_mb,
        )  # fmt: skip
        config = check(config, source="options")
        _made(merge_releases(config, self.releases, self._place(config), workers=self.workers))


@dataclass(frozen=True, kw_only=True)
class DatasetFilter(_Derived):
    """Make a release of some episodes of another, frames copied byte for byte. Conditions must hold together.

    Example: gym-open dataset filter datasets/open/explore/1.0.0 --name open/touching --min-contact 0.2
    """

    release: Release
    """Folder of a release."""
    explorer: tuple[str, ...] = ()
    """Only episodes of these explorers."""
    world: tuple[str, ...] = ()
    """Only episodes in these worlds: layout digests, or their first six digits or more."""
    min_contact: float = 0.0
    """Only episodes in which the agent touches something in at least this share of the steps."""
    min_coverage: float = 0.0
    """Only episodes in which the agent visits at least this share of the table's 5 cm cells."""
    split: tuple[Split, ...] = ()
    """Only episodes of these splits."""

    about = "some episodes of a release as another"

    def run(self) -> None:
        """Filter."""
        from gym_open.datasets.filter import filter_release

        config = FilterConfig(
            name=self.name, version=self.version, license=self.license, published=self.published,
            data_file_mb=self.data_file_mb, explorer=self.explorer, world=self.world, split=self.split,
            min_contact=self.min_contact, min_coverage=self.min_coverage,
        )  # fmt: skip
        config = check(config, source="options")
        _made(filter_release(config, self.release, self._place(config), workers=self.workers))


@dataclass(frozen=True, kw_only=True)
class DatasetSign(Command):
    """Sign a release with a private key, off-line. Needs `gym-open[sign]`.

    Example: gym-open dataset sign datasets/open/explore/1.0.0 --key private.pem
    """

    release: Release
    """Folder of a release."""
    key: Path
    """Private key: an elliptic curve's, PEM."""

    about = "sign a release with a key"

    def run(self) -> None:
        """Sign."""
        from gym_open.datasets.signing import sign_release

        say(short(sign_release(self.release, self.key)), verb="made")
        say(f"  next: gym-open dataset verify {word(self.release)} --quick --key PUBLIC_KEY")


@dataclass(frozen=True, kw_only=True)
class DatasetPush(Command):
    """Send a verified release to a Hugging Face hub, tagged with its version. Without --online, only say what would be.

    Example: gym-open dataset push datasets/open/explore/1.0.0 --repo me/explore --online
    """

    release: Release
    """Folder of a release."""
    repo: str
    """OWNER/NAME on the hub."""
    online: bool = False
    """Really send it."""
    endpoint: str | None = None
    """Address of another hub; default HF_ENDPOINT, or huggingface.co."""

    about = "send a release to a Hugging Face hub"

    def run(self) -> None:
        """Send, or say what would be sent."""
        from gym_open.datasets.hub import push_release

        for line in push_release(self.release, self.repo, send=self.online, endpoint=self.endpoint):
            say(f"  {line}")
        if not self.online:
            say("nothing was sent; add --online to send it")


@dataclass(frozen=True, kw_only=True)
class DatasetPull(Command):
    """Fetch a version of a release from a Hugging Face hub and check it. Without --online, only say what would be done.

    Example: gym-open dataset pull me/explore --version 1.0.0 --online
    """

    repo: Annotated[str, tyro.conf.Positional]
    """OWNER/NAME on the hub."""
    version: str
    """Version to fetch."""
    out: Path | None = None
    """Folder to put it in; default datasets/OWNER/NAME/VERSION."""
    online: bool = False
    """Really fetch it."""
    endpoint: str | None = None
    """Address of another hub; default HF_ENDPOINT, or huggingface.co."""

    about = "fetch a release from a Hugging Face hub and check it"

    def run(self) -> None:
        """Fetch."""
        from gym_open.datasets.hub import pull_release

        folder = self.out or Path("datasets") / self.repo / self.version
        path = pull_release(self.repo, self.version, folder, send=self.online, endpoint=self.endpoint)
        if not self.online:
            say(f"would fetch {self.repo} {self.version} to {short(path)}; add --online to do it")
            return
        say(short(path), verb="made")
        say(f"  next: gym-open dataset verify {word(path)}")


def _made(made: artefacts.Outcome) -> None:
    from gym_open.datasets.overview import summary_tables

    for table in summary_tables(made.path):
        out.print(table)
    path = word(made.path)
    recording = shlex.quote(f"{made.path.parent.name}-{made.path.name}.rrd")
    report(
        made,
        f"gym-open dataset verify {path}",
        f"gym-open train encoder --release {path}",
        f"gym-open viz {path} --save {recording}",
    )
