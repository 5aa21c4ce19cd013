"""Probes of encoders (`probe.json`, as `gym-open train probe` writes it) as tables of a report."""

from collections.abc import Iterator, Sequence

import msgspec

from gym_open.artefacts import Lineage
from gym_open.errors import ArtefactError
from gym_open.results.names import one_line
from gym_open.results.records import ProbeRecord, ProbeTarget
from gym_open.results.runs import ScoredRun


class ProbeTable(msgspec.Struct, frozen=True):
    """One encoder."""

    encoder: str
    """Kind and digest."""
    agents: list[str]
    """Agents of the report whose policies started from it."""
    columns: list[str]
    rows: dict[str, ProbeTarget]


def probe_tables(probes: Sequence[ProbeRecord], runs: Sequence[ScoredRun]) -> list[ProbeTable]:
    """Make a table per probe; encoders that agents of the report started from are first.

    Raises:
        ArtefactError: if a probe names no encoder.
    """
    tables = [_table(probe, runs) for probe in probes]
    return sorted(tables, key=lambda table: (not table.agents, table.agents, table.encoder))


def _table(probe: ProbeRecord, runs: Sequence[ScoredRun]) -> ProbeTable:
    if not probe.lineage.parents:
        raise ArtefactError(f"{probe.folder}: its lineage names no encoder; probe the encoder again")
    parent = probe.lineage.parents[0]
    return ProbeTable(
        encoder=f"{one_line(parent.lineage.kind)} {parent.digest[:12]}",
        agents=list(dict.fromkeys(run.name for run in runs if parent.digest in _digests(run.lineage))),
        columns=sorted({one_line(name) for row in probe.targets.values() for name in row.scores}, key=_place),
        rows={one_line(target): row for target, row in probe.targets.items()},
    )


def _place(column: str) -> tuple[int, str]:
    known = ("trained", "untrained", "pixels")
    return known.index(column) if column in known else len(known), column


def _digests(lineage: Lineage) -> Iterator[str]:
    for parent in lineage.parents:
        yield parent.digest
        yield from _digests(parent.lineage)
