"""Sub-commands on dataset releases: build, verify, compare, inspect, export, sign and publish."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gym_open import artefacts
from gym_open.cli.base import ArtefactCommand, Command, report, say, say_made, say_next, show
from gym_open.cli.stages import Settings, StageCommand
from gym_open.config import check
from gym_open.datasets.config import FilterConfig, Header, License, MergeConfig, ReleaseConfig
from gym_open.errors import GymOpenError, UsageError
from gym_open.formats.releases.layout import Split
from gym_open.summary import short, word

Release = Annotated[Path, tyro.conf.Positional]
"""Folder of a release."""


@dataclass(frozen=True, kw_only=True)
class DatasetBuild(ArtefactCommand, StageCommand):
    """Build a versioned LeRobot v3.0 release from logs, with bit-exact frames.

    The version must follow from the changes since the previous release; `gym-open dataset diff` says which it is.

    Example: gym-open dataset build --logs collect/logs/curl-ride collect/logs/icm --version 1.0.0
    """

    settings: Settings[ReleaseConfig]
    logs: tuple[Path, ...]
    """Folders of logs from `gym-open collect`."""
    out: Path | None = None
    """Folder of the release; default datasets/NAMESPACE/NAME/VERSION."""
    previous: Path | None = None
    """Release to compare with; default the highest lower version in the same folder."""
    append: bool = False
    """Copy the previous release, and add the logs to it."""
    workers: int | None = None
    """Threads that encode images; default one per core. The result does not depend on it."""
    replace: bool = False
    """If the folder at --out was made from other inputs, rename it instead of refusing to build; for drafts."""

    default = "datasets/explore.toml"
    about = "build a LeRobot release from logs"

    def run(self) -> None:
        """Build the release."""
        from gym_open.datasets.build import build_release

        if not self.logs:
            raise UsageError("--logs: expected at least one folder of logs, got none; make one with `gym-open collect`")
        folder = self.place(self.out, f"datasets/{self.settings.name}", self.settings.version)
        made = build_release(
            self.settings, self.logs, folder,
            previous=self.previous, append=self.append, workers=self.workers, replace=self.replace,
        )  # fmt: skip
        _made(made)


@dataclass(frozen=True, kw_only=True)
class DatasetVerify(Command):
    """Verify a release: bytes, structure, statistics, whether other programs can read it, and a replay.

    Example: gym-open dataset verify datasets/open/explore/1.0.0 --quick
    """

    release: Release
    """Folder of a release."""
    quick: bool = False
    """Skip the replay, which simulates every action again and compares every pixel."""
    tolerance: float = 1e-3
    """Largest difference of a number (m, m/s, rad/s, N s) before a window of the replay counts as diverged."""
    key: Path | None = None
    """Public key (PEM) that must match the release's signature."""

    about = "verify a release: bytes, structure, statistics, replay"

    def run(self) -> None:
        """Verify the release, and fail if there are problems."""
        from gym_open.datasets.verify import verify_release

        found = verify_release(self.release, replay=not self.quick, tolerance=self.tolerance, key=self.key)
        show(*found.tables())
        say(found.verdict)
        if found.problems:
            raise GymOpenError(f"{short(self.release)}: {len(found.problems)} problem(s), see above")


@dataclass(frozen=True, kw_only=True)
class DatasetDiff(Command):
    """Show the changes between two releases, by file and by meaning, and the version that they require.

    Example: gym-open dataset diff datasets/open/explore/1.0.0 datasets/open/explore/1.1.0
    """

    one: Release
    """Folder of the earlier release."""
    other: Release
    """Folder of the later release."""

    about = "show the changes between two releases"

    def run(self) -> None:
        """Compare the releases, and print tables."""
        from gym_open.datasets.compare.diff import diff_releases, diff_tables
        from gym_open.datasets.compare.versions import implied
        from gym_open.replay.compact import open_dataset

        one, other = open_dataset(self.one), open_dataset(self.other)
        found = diff_releases(one, other)
        show(*diff_tables(found))
        if found.bump == "none":
            say("the same release; only version and date may differ")
        else:
            say(f"{found.bump}: after {one.version} comes {implied(one.version, found.bump)}", verb="implied version")


@dataclass(frozen=True, kw_only=True)
class DatasetInfo(Command):
    """Show what a release contains.

    Example: gym-open dataset info datasets/open/explore/1.0.0
    """

    release: Release
    """Folder of a release."""

    about = "show what a release contains"

    def run(self) -> None:
        """Read the release, and print tables."""
        from gym_open.datasets.overview import info_tables

        show(*info_tables(self.release))
        say_next(f"gym-open dataset verify {word(self.release)}")


@dataclass(frozen=True, kw_only=True)
class DatasetList(Command):
    """List the releases in a folder, at any depth.

    Example: gym-open dataset list datasets
    """

    folder: Annotated[Path, tyro.conf.Positional] = Path("datasets")
    """Folder to search."""

    about = "list the releases in a folder"

    def run(self) -> None:
        """Search the folder, and print a table."""
        from gym_open.datasets.overview import list_table

        show(list_table(self.folder))


@dataclass(frozen=True, kw_only=True)
class DatasetExport(Command):
    """Export one split of a release as NumPy arrays or as a Minari dataset, or a preview of all of it for a browser.

    Example: gym-open dataset export datasets/open/explore/1.0.0 --form npz --split train --out train.npz
    """

    release: Release
    """Folder of a release."""
    out: Path
    """The .npz file to write, the folder of Minari's datasets, or the folder of the preview."""
    form: Literal["npz", "minari", "preview"] = "npz"
    """Format to write; Minari needs `gym-open[minari]`. A preview is a LeRobot dataset with video that browsers play,
    which LeRobot's online visualizer shows."""
    split: str = "train"
    """Split to export; a preview has all splits."""
    dataset_id: str | None = None
    """Minari's id of the dataset, NAMESPACE/NAME-vN; default the release's name, split and major version."""

    about = "export a split as NumPy (npz) or Minari, or a preview"

    def run(self) -> None:
        """Export the split."""
        from gym_open.datasets.export import export_minari, export_npz
        from gym_open.replay.compact import open_dataset

        if self.form == "preview":
            from gym_open.datasets.preview import export_preview

            path = export_preview(self.release, self.out)
        elif self.form == "npz":
            path = export_npz(self.release, self.split, self.out)
        else:
            about = open_dataset(self.release)
            named = f"{about.name}-{self.split}-v{about.version.split('.')[0]}"
            path = export_minari(self.release, self.split, self.out, self.dataset_id or named)
        say_made(path)


@dataclass(frozen=True, kw_only=True)
class _DerivedReleaseCommand(ArtefactCommand):
    """Options of commands that make a release from other releases."""

    name: str
    """NAMESPACE/NAME of the new release."""
    version: str = "1.0.0"
    """Version of the new release."""
    license: License = "mit"
    """Licence of the new release."""
    published: str = ""
    """Date of the new release, YYYY-MM-DD; no date if empty."""
    data_file_mb: int = 100
    """Size in memory, in MiB, at which a new data file begins."""
    out: Path | None = None
    """Folder of the new release; default datasets/NAMESPACE/NAME/VERSION."""
    workers: int | None = None
    """Threads that encode images; default one per core."""

    def _place(self, config: Header) -> Path:
        return self.out or Path("datasets") / config.name / config.version


@dataclass(frozen=True, kw_only=True)
class DatasetMerge(_DerivedReleaseCommand):
    """Merge several releases into one; frames are copied byte for byte.

    Example: gym-open dataset merge datasets/open/icm/1.0.0 datasets/open/rnd/1.0.0 --name open/both
    """

    releases: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of releases."""

    about = "merge several releases into one"

    def run(self) -> None:
        """Merge the releases."""
        from gym_open.datasets.merge import merge_releases

        if not self.releases:
            raise UsageError("expected at least one release, got none; give the folders of releases")
        config = MergeConfig(
            name=self.name, version=self.version, license=self.license, published=self.published,
            data_file_mb=self.data_file_mb,
        )  # fmt: skip
        config = check(config, source="options")
        _made(merge_releases(config, self.releases, self._place(config), workers=self.workers))


@dataclass(frozen=True, kw_only=True)
class DatasetFilter(_DerivedReleaseCommand):
    """Make a release from some episodes of another; frames are copied byte for byte. All conditions must hold.

    Example: gym-open dataset filter datasets/open/explore/1.0.0 --name open/touching --min-contact 0.2
    """

    release: Release
    """Folder of a release."""
    explorer: tuple[str, ...] = ()
    """Only episodes of these explorers."""
    world: tuple[str, ...] = ()
    """Only episodes in these worlds: layout digests, or at least their first six digits."""
    min_contact: float = 0.0
    """Only episodes with contacts of the agent in at least this share of the steps."""
    min_coverage: float = 0.0
    """Only episodes in which the agent visits at least this share of the table's 5 cm cells."""
    split: tuple[Split, ...] = ()
    """Only episodes of these splits."""
    leave_out: tuple[str, ...] = ()
    """Features with the explorer's own values to leave out: their names, or `explorer` for all of them."""

    about = "make a release from some episodes of another"

    def run(self) -> None:
        """Filter the release."""
        from gym_open.datasets.filter import filter_release

        config = FilterConfig(
            name=self.name, version=self.version, license=self.license, published=self.published,
            data_file_mb=self.data_file_mb, explorer=self.explorer, world=self.world, split=self.split,
            min_contact=self.min_contact, min_coverage=self.min_coverage, leave_out=self.leave_out,
        )  # fmt: skip
        config = check(config, source="options")
        _made(filter_release(config, self.release, self._place(config), workers=self.workers))


def _made(made: artefacts.Outcome) -> None:
    from gym_open.datasets.overview import summary_tables

    show(*summary_tables(made.path))
    path = word(made.path)
    recording = shlex.quote(f"{made.path.parent.name}-{made.path.name}.rrd")
    report(
        made,
        f"gym-open dataset verify {path}",
        f"gym-open train encoder --release {path}",
        f"gym-open viz {path} --save {recording}",
    )
