"""All that a report is made of: scores, probes and configurations below some folders."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gym_open import artefacts, progress
from gym_open.artefacts import CONFIG, Lineage
from gym_open.envs.puzzles import TASKS
from gym_open.envs.puzzles.sets import Split
from gym_open.errors import ArtefactError, UsageError
from gym_open.files import sha256_file
from gym_open.formats.scores import RECORD
from gym_open.results.records import PROBE, ProbeRecord, read_probe
from gym_open.results.runs import ScoredRun, artefact_folders, distinct, read_run


@dataclass(frozen=True)
class ReportSources:
    """All that a report is made of."""

    runs: list[ScoredRun]
    probes: list[ProbeRecord]
    configs: dict[str, dict[str, Any]]
    """Configurations that the lineages of `runs` name, by SHA-256 of their file, as far as they were found."""
    left_out: list[str]
    """What was found but not used, and why."""

    @property
    def folders(self) -> list[Path]:
        """Folders of the scores and probes."""
        return [run.folder for run in self.runs] + [probe.folder for probe in self.probes]


def gather(sources: Sequence[Path], split: Split) -> ReportSources:
    """Find, check and read all scores and probes below some folders.

    Unfinished artefacts (hidden folders) are skipped. If two scores have the same agent, task, seed and training
    length, one is left out if `build` had set it aside (NAME-1 next to NAME) or if both say the same; otherwise they
    are an error.

    Raises:
        UsageError: if a source is no folder, or holds no scores of the split.
        ArtefactError: if an artefact is damaged, cannot be read, contradicts itself or contradicts another.
    """
    found = dict.fromkeys(path for source in sources for path in _artefacts(source))
    runs, probes, left_out = dict[str, ScoredRun](), dict[str, ProbeRecord](), list[str]()
    other = 0
    with progress.bar("read scores", len(found)) as bar:
        for folder in found:
            if (folder / RECORD).is_file():
                run = read_run(folder)
                if run.record.split == split:
                    runs.setdefault(run.digest, run)
                else:
                    other += 1
            elif (folder / PROBE).is_file():
                probe = read_probe(folder)
                probes.setdefault(probe.digest, probe)
            bar.advance()
    if other:
        left_out.append(f"Scores on another split than {split!r} were left out: {other}.")
    if not runs:
        names = ", ".join(map(str, sources))
        raise UsageError(f"{names}: no scores of the {split} puzzles below; make some with `gym-open evaluate`")
    kept, aside, doubles = distinct(list(runs.values()))
    for run, first in doubles:
        task, _, name, seed, trained = run.identity
        raise ArtefactError(
            f"{run.folder} and {first.folder}: both are scores of {name} on {task}, seed {seed}, {trained:,} steps"
            "; give folders that hold only one of them, or, if they are different agents, train them with names of "
            "their own (`gym-open train policy --agent NAME`)"
        )
    if aside:
        left_out.append(f"Scores that newer scores had set aside (NAME-1 next to NAME) were left out: {len(aside)}.")
    kept.sort(key=lambda run: (TASKS.index(run.record.task), run.identity))
    return ReportSources(
        runs=kept,
        probes=sorted(probes.values(), key=lambda probe: probe.digest),
        configs=_configs(kept, itertools.chain(found, _workspace_artefacts(sources))),
        left_out=left_out,
    )


def _artefacts(source: Path) -> Iterator[Path]:
    if not source.is_dir():
        raise UsageError(f"{source}: no such folder; give folders that hold scores")
    return artefact_folders(source)


def _configs(runs: Sequence[ScoredRun], folders: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """Return the configurations in `folders` that the runs come from; their bytes identify them, not their place."""
    wanted = {run.config_sha256 for run in runs}.union(*(_named(run.lineage) for run in runs))
    configs: dict[str, dict[str, Any]] = {}
    for folder in folders:
        if wanted <= configs.keys():
            break
        with suppress(OSError):  # another process may have just set it aside
            sha256 = sha256_file(folder / CONFIG)
            if sha256 in wanted and sha256 not in configs:
                configs[sha256] = artefacts.config_of(folder)
    return configs


def _named(lineage: Lineage) -> Iterator[str]:
    for parent in lineage.parents:
        if CONFIG in parent.manifest:
            yield parent.manifest[CONFIG].sha256
        yield from _named(parent.lineage)


def _workspace_artefacts(sources: Sequence[Path]) -> Iterator[Path]:
    """Yield the artefacts in the other stage folders of the workspaces that the sources belong to."""
    for source in sources:
        above = (source.resolve(), *source.resolve().parents)
        root = next((folder.parent for folder in above if folder.name == "evaluate"), None)
        for stage in ("train", "datasets", "collect"):
            if root is not None and (root / stage).is_dir():
                yield from artefact_folders(root / stage)
