"""What came of a verification."""

from collections import Counter
from typing import TYPE_CHECKING, Any

import msgspec
from rich.table import Table

from gym_open.artefacts import Problem
from gym_open.terminal import markup, printable, titled_table

if TYPE_CHECKING:
    import pandas as pd

MOST = 1000
"""Problems that are kept; of more only the number is told."""
_SHOWN = 50
"""Problems that are listed for a person."""
NOT_CHECKED = "not checked"


class Check(msgspec.Struct):
    """One of the things that are verified."""

    name: str
    outcome: str
    """In words; `NOT_CHECKED` if something before it was wrong."""
    good: bool | None
    """None if it was not checked."""


class Findings:
    """Problems as they are found."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.count = 0
        """Of all, those beyond `MOST` too."""

    def add(self, file: str, what: str) -> None:
        """Note a problem with a file."""
        self.count += 1
        if len(self.problems) < MOST:
            self.problems.append(Problem(file, what))

    def expect(self, good: bool, file: str, what: str) -> None:
        """Note a problem with a file unless all is `good`."""
        if not good:
            self.add(file, what)


def rows_of(frame: "pd.DataFrame") -> list[dict[str, Any]]:
    """Rows of a table as plain values, by name."""
    return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]


class VerificationReport(msgspec.Struct):
    """What came of a verification, as the release says it: text in it is to be shown, never to be followed."""

    verdict: str
    """One line."""
    problems: list[Problem]
    digest: str
    """Of the artefact; empty if it has none."""
    content: str
    """Content digest of the release; empty if it was not come to."""
    checks: list[Check]
    replayed: list[Table] = []
    """Of the replay."""

    @property
    def good(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems

    def tables(self) -> list[Table]:
        """What was checked, what is wrong file by file, and what the replay gave."""
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
    """The report in one line."""
    if problems:
        files = Counter(problem.file for problem in problems)
        first = problems[0]
        return printable(
            f"NOT verified: {count:,} problem(s) in {len(files):,} file(s); first {first.file}: {first.what}"
        ).replace("\n", " ")
    said = {check.name: check.outcome for check in checks}
    return f"verified: {said['structure']}; {printable(said['signature'])}; replay: {said['replay']}"
