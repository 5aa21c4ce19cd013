"""Results of a verification: checks, problems and their tables."""

from collections import Counter
from typing import TYPE_CHECKING, Any

import msgspec
from rich.table import Table

from gym_open.artefacts import Problem
from gym_open.terminal import markup, printable, titled_table

if TYPE_CHECKING:
    import pandas as pd

MOST = 1000
"""Largest number of recorded problems. Further problems are only counted."""
_SHOWN = 50
"""Largest number of problems in a table."""
NOT_CHECKED = "not checked"


class Check(msgspec.Struct):
    """One check of a verification."""

    name: str
    outcome: str
    """Outcome in words; `NOT_CHECKED` if an earlier check failed."""
    good: bool | None
    """Whether the check passed; None if it was not reached."""


class Findings:
    """Collects problems as they are found."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.count = 0
        """Number of all problems, including those beyond `MOST`."""

    def add(self, file: str, what: str) -> None:
        """Record a problem of a file."""
        self.count += 1
        if len(self.problems) < MOST:
            self.problems.append(Problem(file, what))

    def expect(self, good: bool, file: str, what: str) -> None:
        """Record a problem of a file unless `good`."""
        if not good:
            self.add(file, what)


def rows_of(frame: "pd.DataFrame") -> list[dict[str, Any]]:
    """Rows of a table as dictionaries of plain values."""
    return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]


class VerificationReport(msgspec.Struct):
    """Result of a verification. Its texts come from the release: show them, but do not trust them."""

    verdict: str
    """Summary in one line."""
    problems: list[Problem]
    digest: str
    """Digest of the artefact; empty if it has none."""
    content: str
    """Content digest of the release; empty if this check was not reached."""
    checks: list[Check]
    replayed: list[Table] = []
    """Tables of the replay."""

    @property
    def good(self) -> bool:
        """Whether there is no problem."""
        return not self.problems

    def tables(self) -> list[Table]:
        """Tables of all checks, of the problems by file, and of the replay."""
        checks = titled_table("what was checked", ("check", "outcome"))
        for check in self.checks:
            colour = {None: "dim", True: "green", False: "red"}[check.good]
            checks.add_row(f"[{colour}]{markup(check.name)}[/]", markup(check.outcome))
        shown = [checks]
        if self.problems:
            listed = self.problems[:_SHOWN]
            problems = titled_table(f"problems ({len(listed)} of {len(self.problems)})", ("file", "what is wrong"))
            for problem in listed:
                problems.add_row(markup(problem.file), markup(problem.what))
            shown.append(problems)
        return shown + self.replayed


def verdict_of(checks: list[Check], problems: list[Problem], count: int) -> str:
    """Summarise the report in one line."""
    if problems:
        files = Counter(problem.file for problem in problems)
        first = problems[0]
        return printable(
            f"NOT verified: {count:,} problem(s) in {len(files):,} file(s); first {first.file}: {first.what}"
        ).replace("\n", " ")
    said = {check.name: check.outcome for check in checks}
    return f"verified: {said['structure']}; {printable(said['signature'])}; replay: {said['replay']}"
