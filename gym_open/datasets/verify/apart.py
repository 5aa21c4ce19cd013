"""Replay of a release in a separate process.

MuJoCo ends its process, with a line in MUJOCO_LOG.TXT, if it loads a state that no simulation reaches, such as sleeping
bodies that touch. The states in a release may be anything. In a separate process, such a state ends only that process.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec

from gym_open.artefacts import Problem
from gym_open.datasets.verify.replaying import ReplayResult, replay_release
from gym_open.datasets.verify.report import Findings
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.reader import Release
from gym_open.terminal import printable

_CACHED_GROUPS = 4
"""Number of row groups whose images stay in memory. Episodes are read one after the other."""


class _ReplayRecord(msgspec.Struct):
    replay: ReplayResult
    problems: list[Problem]
    count: int


def replay_apart(release: Release, tolerance: float, findings: Findings) -> ReplayResult:
    """Replay as `replay_release` does. If the simulation ends the process, that is a problem of the release."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "replay"
        code = f"import sys; from {__name__} import main; main(*sys.argv[1:])"
        code = f"from gym_open.processes import end_with_parent as end; end(); {code}"
        words = [sys.executable, "-c", code, str(release.root.absolute()), repr(tolerance), str(out)]
        done = subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, check=False)  # noqa: S603  # our own module
        if done.returncode == 0:
            result = msgspec.msgpack.decode(out.read_bytes(), type=_ReplayRecord)
            for problem in result.problems:
                findings.add(problem.file, problem.what)
            findings.count += result.count - len(result.problems)
            return result.replay
        log = Path(folder) / "MUJOCO_LOG.TXT"
        said = log.read_text(errors="replace").strip().splitlines()[-1:] if log.exists() else []
        what = printable(" ".join(said)[:300]) or "no message"
        findings.add(
            "meta/keyframes",
            f"the simulation ended, code {done.returncode}: {what}; no simulation reaches such a state: do not use "
            "this release",
        )
        return ReplayResult([])


def main(root: str, tolerance: str, out: str) -> None:
    """Replay a release and write the result."""
    release = Release(Path(root), "", read_info(Path(root)), cached_groups=_CACHED_GROUPS)
    findings = Findings()
    try:
        replay = replay_release(release, float(tolerance), findings)
    except Exception as error:  # a hostile release can make libraries raise anything
        replay = ReplayResult([])
        findings.add(".", f"replay cannot be checked: {type(error).__name__}: {error}"[:500])
    Path(out).write_bytes(msgspec.msgpack.encode(_ReplayRecord(replay, findings.problems, findings.count)))
