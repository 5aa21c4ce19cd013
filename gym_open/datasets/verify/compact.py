"""Verify a compact release: every byte, every row, the signature, and every frame, which is simulated in a child.

The child process simulates, since MuJoCo ends its process if a stored state is one that no simulation reaches.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from gym_open.datasets.compact.check import check_frames
from gym_open.datasets.verify.report import NOT_CHECKED, Check, Findings, VerificationReport, verdict_of
from gym_open.errors import GymOpenError, UsageError
from gym_open.formats.compact import Compact, open_compact
from gym_open.terminal import printable


def verify_compact(root: Path, *, replay: bool = True, key: Path | None = None) -> VerificationReport:
    """Check bytes, rows and signature of a compact release, and simulate all frames.

    Args:
        root: folder of the compact release, which may be hostile.
        replay: also simulate it, and compare every episode with its digest.
        key: PEM file of the public key that must have signed the compact release.

    Raises:
        UsageError: if the key is not valid.
    """
    report, findings, checks = VerificationReport("", [], "", "", []), Findings(), list[Check]()
    opened: list[Compact] = []

    def structure() -> str:
        opened.append(open_compact(root))
        info = opened[0].info
        _ = opened[0].puzzles, opened[0].switches, opened[0].streams
        return f"{info.name} {info.version}: {info.episodes:,} episodes, {info.steps:,} steps"

    def signature() -> str:
        from gym_open.datasets.signing import check_signature

        return check_signature(root, key)

    def frames() -> str:
        _simulate_apart(root)
        info = opened[0].info
        return f"identical ({info.steps:,} steps in {info.episodes:,} episodes have the content that was packed)"

    sound = _check("structure", structure, root, checks, findings)
    _check("signature", signature, root, checks, findings, needs=sound)
    if replay:
        _check("replay", frames, root, checks, findings, needs=sound)
    else:
        checks.append(Check("replay", f"{NOT_CHECKED}, as asked", None))
    if opened:
        report.digest, report.content = opened[0].digest, opened[0].info.content
    report.checks, report.problems = checks, findings.problems
    report.verdict = verdict_of(checks, findings.problems, findings.count)
    return report


def _check(
    name: str, work: Callable[[], str], root: Path, checks: list[Check], findings: Findings, *, needs: bool = True
) -> bool:
    """Run one check and note its result; return whether it passed."""
    if not needs:
        checks.append(Check(name, f"{NOT_CHECKED}: an earlier check failed", None))
        return False
    try:
        outcome = work()
    except UsageError:  # about a key or a missing package: for the caller
        raise
    except Exception as error:  # a hostile file can make libraries raise anything
        text = str(error) if isinstance(error, GymOpenError) else f"{type(error).__name__}: {error}"
        place = text.removeprefix(f"{root}/").split(":")[0] if text.startswith(f"{root}/") else "."
        findings.add(place, printable(text[:1000]))
        checks.append(Check(name, "1 problem(s)", False))
        return False
    checks.append(Check(name, outcome, True))
    return True


def _simulate_apart(root: Path) -> None:
    """Simulate in a child process. Raises GymOpenError with what is wrong."""
    with tempfile.TemporaryDirectory() as folder:
        code = f"import sys; from {__name__} import main; main(*sys.argv[1:])"
        code = f"from gym_open.processes import end_with_parent as end; end(); {code}"
        out = Path(folder) / "said"
        words = [sys.executable, "-c", code, str(root.absolute()), str(out)]
        done = subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, check=False)  # noqa: S603  # our own module
        if done.returncode == 0:
            if said := out.read_text(encoding="utf-8"):
                raise GymOpenError(said)
            return
        log = Path(folder) / "MUJOCO_LOG.TXT"
        said = log.read_text(errors="replace").strip().splitlines()[-1:] if log.exists() else []
        what = printable(" ".join(said)[:300]) or "no message"
        raise GymOpenError(f"{root}: the simulation ended, code {done.returncode}: {what}; do not use this release")


def main(root: str, out: str) -> None:
    """Simulate a compact release and write what is wrong, or nothing."""
    said = ""
    try:
        check_frames(open_compact(Path(root)))
    except GymOpenError as error:
        said = str(error)
    Path(out).write_text(said, encoding="utf-8")
