"""Run all checks of a release in their order. A check runs only if those on which it depends passed."""

import math
from collections.abc import Callable
from pathlib import Path

from gym_open import artefacts, extras
from gym_open.datasets.verify.apart import replay_apart
from gym_open.datasets.verify.compact import verify_compact
from gym_open.datasets.verify.contents import check_contents
from gym_open.datasets.verify.documents import check_documents, check_texts
from gym_open.datasets.verify.readers import check_lerobot, check_pandas
from gym_open.datasets.verify.report import NOT_CHECKED, Check, Findings, VerificationReport, verdict_of
from gym_open.datasets.verify.structure import check_episodes, check_files, check_info
from gym_open.datasets.verify.tables import check_tables
from gym_open.errors import GymOpenError, UsageError
from gym_open.formats.compact.reader import is_compact
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.layout import SIGNATURE, belongs
from gym_open.formats.releases.reader import Release

CACHED_GROUPS = 4
"""Number of row groups whose images stay in memory. Episodes are read one after the other."""


def verify_release(
    root: Path, *, replay: bool = True, tolerance: float = 1e-3, key: Path | None = None
) -> VerificationReport:
    """Check bytes, signature, structure, documents, frames and readers of a release, and replay it.

    Args:
        root: folder of the release, which may be hostile.
        replay: also simulate it again.
        tolerance: largest difference of a number (m, m/s, rad/s, N s) at which a window has not diverged.
        key: PEM file of the public key that must have signed the release.

    Raises:
        UsageError: if the tolerance is no number from 0 on, there is no such folder, or the key is not valid.
    """
    if not 0 <= tolerance < math.inf:
        raise UsageError(f"--tolerance: expected 0 or more, got {tolerance}")
    if not root.is_dir():
        raise UsageError(f"{root}: no such folder; give the folder of a release")
    if is_compact(root):
        return verify_compact(root, replay=replay, key=key)
    return _Verification(root, key).run(replay, tolerance)


class _Verification:
    """A verification and its findings so far."""

    def __init__(self, root: Path, key: Path | None) -> None:
        self._root, self._key = root, key
        self._findings = Findings()
        self._checks: list[Check] = []
        self._digest = self._content = ""
        self._names: set[str] = set()
        self._release: Release | None = None

    def run(self, replay: bool, tolerance: float) -> VerificationReport:
        """Run all checks."""
        report = VerificationReport("", [], "", "", self._checks)
        sound = self._check("bytes", self._bytes)
        self._check("signature", self._signature, needs=sound)  # no later check depends on it
        sound = self._check("structure", self._structure, needs=sound)
        documents = self._check("documents", self._documents, needs=sound)
        sound = self._check("frames", self._frames, needs=sound)
        self._check("texts", self._texts, needs=sound and documents)
        self._check("readers", self._readers, needs=sound)

        def play() -> str:
            assert self._release is not None
            done = replay_apart(self._release, tolerance, self._findings)
            report.replayed = done.tables(tolerance)
            return done.outcome

        if replay:
            self._check("replay", play, needs=sound)
        else:
            self._checks.append(Check("replay", f"{NOT_CHECKED}, as asked", None))
        report.problems = self._findings.problems
        report.digest, report.content = self._digest, self._content
        report.verdict = verdict_of(self._checks, report.problems, self._findings.count)
        return report

    def _check(self, name: str, work: Callable[[], str], *, needs: bool = True) -> bool:
        """Run one check, unless one that it needs failed. Return whether it passed. An exception is a problem too."""
        if not needs:
            self._checks.append(Check(name, f"{NOT_CHECKED}: an earlier check failed", None))
            return False
        before = self._findings.count
        try:
            with extras.Named():
                outcome = work()
        except UsageError:  # about a key or a missing package: for the caller
            raise
        except GymOpenError as error:
            self._findings.add(self._place(str(error)), str(error))
            outcome = ""
        except Exception as error:  # a hostile release can make libraries raise anything
            self._findings.add(".", f"{name} cannot be checked: {type(error).__name__}: {error}"[:500])
            outcome = ""
        found = self._findings.count - before
        self._checks.append(Check(name, f"{found:,} problem(s)" if found else outcome, not found))
        return not found

    def _place(self, error: str) -> str:
        """The file in the release that an error names, or `.`."""
        prefix = f"{self._root}/"
        return error.removeprefix(prefix).split(":")[0] if error.startswith(prefix) else "."

    def _bytes(self) -> str:
        self._digest = artefacts.digest(self._root)
        for problem in artefacts.problems(self._root):
            self._findings.add(problem.file, problem.what)
        manifest = artefacts.manifest(self._root)
        if (kind := artefacts.lineage(self._root).kind) != "release":
            self._findings.add(artefacts.LINEAGE, f"an artefact of kind {kind!r}, expected 'release'")
        for name in sorted(manifest):
            if not belongs(name) or name == SIGNATURE:
                self._findings.add(name, "no release of this format has such a file; do not use this release")
        self._names = set(manifest)
        return f"{len(manifest):,} files, {sum(entry.bytes for entry in manifest.values()):,} bytes as in the manifest"

    def _signature(self) -> str:
        from gym_open.datasets.signing import check_signature

        return check_signature(self._root, self._key)

    def _structure(self) -> str:
        release = Release(self._root, self._digest, read_info(self._root), cached_groups=CACHED_GROUPS)
        self._release = release
        before = self._findings.count
        check_files(release, self._names, self._findings)
        if self._findings.count == before:
            check_episodes(release, self._findings)
            check_info(release, self._findings)
            check_tables(release, self._findings)
        return f"{len(release.episodes):,} episodes, {len(release):,} frames"

    def _documents(self) -> str:
        assert self._release is not None
        return check_documents(self._release, self._findings)

    def _frames(self) -> str:
        assert self._release is not None
        self._content = check_contents(self._release, self._findings)
        return "statistics and content digests follow from the frames"

    def _texts(self) -> str:
        assert self._release is not None
        return check_texts(self._release, self._findings)

    def _readers(self) -> str:
        assert self._release is not None
        check_pandas(self._release, self._findings)
        if check_lerobot(self._release, self._findings):
            return "LeRobot and pandas read the same frames"
        return "pandas reads the same frames; LeRobot is not installed, so it did not read them"
