"""Probes of encoders (`probe.json`, as `gym-open train probe` writes it) as tables of a report."""

from collections.abc import Iterator, Sequence

import msgspec

from gym_open.artefacts import Lineage
from gym_open.errors import ArtefactError
from gym_open.evaluate.report.gather import Probe, Run, one_line
from gym_open.evaluate.report.results import Estimate


class Row(msgspec.Struct, frozen=True):
    """One target of a probe."""

    measure: str
    guess: float
    """Score without looking at the picture."""
    scores: dict[str, Estimate]
    """By kind of features: `trained`, `untrained`, perhaps `pixels`."""
    gain: Estimate
    """`trained` less `untrained`."""


class Probed(msgspec.Struct, frozen=True):
    """One encoder."""

    encoder: str
    """Kind and digest."""
    agents: list[str]
    """Agents of the report whose policies started from it."""
    columns: list[str]
    rows: dict[str, Row]


def probed(probes: Sequence[Probe], runs: Sequence[Run]) -> list[Probed]:
    """What the probes found, those of encoders that agents of the report started from first.

    Raises:
        ArtefactError: if a record is not as `gym-open train probe` writes it.
    """
    tables = [_probed(probe, runs) for probe in probes]
    return sorted(tables, key=lambda one: (not one.agents, one.agents, one.encoder))


def _probed(probe: Probe, runs: Sequence[Run]) -> Probed:
    try:
        rows = msgspec.convert(probe.record.get("targets"), dict[str, Row])
    except msgspec.ValidationError as error:
        raise ArtefactError(f"{probe.folder}: probe.json: {error}; probe the encoder again") from None
    if not probe.lineage.parents:
        raise ArtefactError(f"{probe.folder}: its lineage names no encoder; probe the encoder again")
    parent = probe.lineage.parents[0]
    return Probed(
        encoder=f"{one_line(parent.lineage.kind)} {parent.digest[:12]}",
        agents=list(dict.fromkeys(run.name for run in runs if parent.digest in _digests(run.lineage))),
        columns=sorted({one_line(name) for row in rows.values() for name in row.scores}, key=_place),
        rows={one_line(target): row for target, row in rows.items()},
    )


def _place(column: str) -> tuple[int, str]:
    known = ("trained", "untrained", "pixels")
    return known.index(column) if column in known else len(known), column


def _digests(lineage: Lineage) -> Iterator[str]:
    for parent in lineage.parents:
        yield parent.digest
        yield from _digests(parent.lineage)
