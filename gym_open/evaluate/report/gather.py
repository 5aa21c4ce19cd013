"""Scores, probes and configurations found below some folders, checked byte by byte before anything is believed."""

import functools
import itertools
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gym_open import artefacts, progress
from gym_open.artefacts import CONFIG, MANIFEST, Lineage
from gym_open.envs.puzzles import TASKS
from gym_open.envs.puzzles.sets import PER_SET, Split, puzzle_id
from gym_open.envs.tasks import step_budget
from gym_open.errors import ArtefactError, UsageError
from gym_open.evaluate.metrics import a_success
from gym_open.evaluate.proof import policy_facts
from gym_open.files import sha256_file
from gym_open.formats.scores import EPISODES, RECORD, Scores, read_episodes, read_scores
from gym_open.terminal import printable

PROBE = "probe.json"
UNTRAINED = ("random", "oracle", "human")
"""Agents that no training made."""
_CEILING = "state"
"""Word in the name of an agent that sees the simulator's state and no pictures."""
_LONGEST = 80
"""Characters of a name that are shown."""
_SAME = 1e-9
"""How far a number in scores.json may be from what its episodes give: rounding of sums, no more."""


def one_line(text: str) -> str:
    """Text from a file on one line, nothing hidden in it, and not endless."""
    shown = printable(text).replace("\n", " ")
    return shown if len(shown) <= _LONGEST else f"{shown[:_LONGEST]}…"


def standing(name: str) -> int:
    """Place of a row: 0 for those that are compared, 1 for what sees the state, then random, oracle and human."""
    first = name.partition(",")[0]
    if first in UNTRAINED:
        return 2 + UNTRAINED.index(first)
    return int(_CEILING in re.findall("[a-z]+", name.lower()))


def is_trained(name: str) -> bool:
    """Whether an agent of that name was trained, on pictures or on the state."""
    return standing(name) < 2


@dataclass(frozen=True)
class Run:
    """One scores artefact."""

    folder: Path
    digest: str
    lineage: Lineage
    record: Scores
    config_sha256: str
    puzzles: tuple[str, ...]
    """Ids, in the order of the rows of `returns`."""
    returns: np.ndarray
    """Return of each puzzle within 1…N actions, shape (puzzles, N)."""
    values: np.ndarray
    """A-Success of each puzzle, shape (puzzles,)."""

    @property
    def name(self) -> str:
        """The agent, with what sets its scores apart from others of that name: a row of the report."""
        parts = [self.record.agent]
        if self.record.actions == "greedy":
            parts.append("greedy")
        if len(self.puzzles) < PER_SET:
            first, last = self.puzzles[0].rpartition("/")[2], self.puzzles[-1].rpartition("/")[2]
            parts.append(f"puzzles {first}–{last}")
        return one_line(", ".join(parts))

    @property
    def seed(self) -> int | str:
        """What tells this run from the others of its row: training seed, or player."""
        player = self.lineage.facts.get("player")
        return one_line(str(player)) if player else self.record.seed or 0

    @property
    def trained(self) -> int:
        """Training steps of the weights that were scored."""
        return self.record.trained

    @property
    def identity(self) -> tuple[str, str, str, int]:
        """No two runs of a report have the same."""
        return self.record.task, self.name, str(self.seed), self.trained


@dataclass(frozen=True)
class Probe:
    """One probe artefact."""

    folder: Path
    digest: str
    lineage: Lineage
    record: dict[str, Any]


@dataclass(frozen=True)
class Sources:
    """All that a report is made of."""

    runs: list[Run]
    probes: list[Probe]
    configs: dict[str, dict[str, Any]]
    """Those that the lineages of `runs` name, by SHA-256 of their file, as far as they were found."""
    folders: list[Path]
    """Of the scores and probes, in the order of `runs` and `probes`."""
    left_out: list[str]
    """What was found and not taken, and why."""


def gather(sources: Sequence[Path], split: Split) -> Sources:
    """Find all scores and probes below the folders, check them, and read them.

    Unfinished artefacts (hidden folders) are passed by. Of two scores of one agent, task, seed and training length, one
    that `build` had set aside (NAME-1 beside NAME) or that says the same is left out; any other such pair is an error.

    Raises:
        UsageError: if a source is no folder, or holds no scores of the split.
        ArtefactError: if an artefact is damaged, cannot be read, contradicts itself, or doubles another.
    """
    found = dict.fromkeys(path for source in sources for path in _artefacts(source))
    runs, probes, left_out = dict[str, Run](), dict[str, tuple[Path, Probe]](), list[str]()
    other = 0
    with progress.bar("read scores", len(found)) as bar:
        for folder in found:
            if (folder / RECORD).is_file():
                run = _run(folder)
                if run.record.split == split:
                    runs.setdefault(run.digest, run)
                else:
                    other += 1
            elif (folder / PROBE).is_file():
                probe = _probe(folder)
                probes.setdefault(probe.digest, (folder, probe))
            bar.advance()
    if other:
        left_out.append(f"Scores on another split than {split!r} were left out: {other}.")
    if not runs:
        names = ", ".join(map(str, sources))
        raise UsageError(f"{names}: no scores of the {split} puzzles below; make some with `gym-open evaluate`")
    kept, aside = _without_set_aside(list(runs.values()))
    if aside:
        left_out.append(f"Scores that newer ones had set aside (NAME-1 beside NAME) were left out: {aside}.")
    kept.sort(key=lambda run: (TASKS.index(run.record.task), run.identity))
    ordered = sorted(probes.values(), key=lambda item: item[1].digest)
    return Sources(
        runs=kept,
        probes=[probe for _, probe in ordered],
        configs=_configs(kept, itertools.chain(found, _beside(sources))),
        folders=[run.folder for run in kept] + [folder for folder, _ in ordered],
        left_out=left_out,
    )


def _artefacts(source: Path) -> Iterator[Path]:
    """Folders with a manifest and a configuration, in the order of their names; none below another, none hidden."""
    if not source.is_dir():
        raise UsageError(f"{source}: no such folder; give folders that hold scores")
    for folder, below, files in os.walk(source):
        below[:] = [] if MANIFEST in files else sorted(name for name in below if not name.startswith("."))
        if MANIFEST in files and CONFIG in files:
            yield Path(folder).resolve()


def _configs(runs: Sequence[Run], folders: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """Of `folders`, the configurations behind the runs; they are known by their bytes, wherever they lie."""
    wanted = {run.config_sha256 for run in runs}.union(*(_named(run.lineage) for run in runs))
    configs: dict[str, dict[str, Any]] = {}
    for folder in folders:
        if wanted <= configs.keys():
            break
        with suppress(OSError):  # set aside by another process just now
            sha256 = sha256_file(folder / CONFIG)
            if sha256 in wanted and sha256 not in configs:
                configs[sha256] = artefacts.config_of(folder)
    return configs


def _named(lineage: Lineage) -> Iterator[str]:
    for parent in lineage.parents:
        if CONFIG in parent.manifest:
            yield parent.manifest[CONFIG].sha256
        yield from _named(parent.lineage)


def _beside(sources: Sequence[Path]) -> Iterator[Path]:
    """Artefacts in the other stage folders of the workspaces that the sources lie in."""
    for source in sources:
        above = (source.resolve(), *source.resolve().parents)
        root = next((folder.parent for folder in above if folder.name == "evaluate"), None)
        for stage in ("train", "datasets", "collect"):
            if root is not None and (root / stage).is_dir():
                yield from _artefacts(root / stage)


def _run(folder: Path) -> Run:
    record, lineage = read_scores(folder), artefacts.lineage(folder)
    _check_player(folder, record, lineage)
    puzzles, rewards, steps = _episodes(folder, record)
    returns = np.cumsum(rewards, axis=1)
    values = returns @ _weights(returns.shape[1])
    numbers = {
        "a_success": float(values.mean()), "mean_return": float(returns[:, -1].mean()), "mean_steps": steps,
        "puzzles": len(puzzles),
    }  # fmt: skip
    for key, found in numbers.items():
        if abs((said := getattr(record, key)) - found) > _SAME:
            raise ArtefactError(f"{folder / RECORD}: `{key}` is {said}, but {EPISODES} gives {found}; evaluate again")
    return Run(
        folder=folder, digest=artefacts.digest(folder), lineage=lineage, record=record,
        config_sha256=sha256_file(folder / CONFIG), puzzles=puzzles, returns=returns, values=values,
    )  # fmt: skip


@functools.cache
def _weights(budget: int) -> np.ndarray:
    """A-Success is linear in s_1…s_N: its value at each unit vector is the weight there."""
    return np.array([a_success(unit) for unit in np.eye(budget)])


def _check_player(folder: Path, record: Scores, lineage: Lineage) -> None:
    """Who played must be who the lineage says; where that names no policy, the proof says what is missing."""
    if record.agent in UNTRAINED:
        claims = [("policy", record.policy, None), ("trained", record.trained, 0)]
        claims += [("agent", record.agent, "that of the policy in its lineage")] if lineage.parents else []
    elif lineage.parents:
        policy = lineage.parents[0]
        facts = policy_facts(policy, folder)
        asked = artefacts.config_of(folder).get("at")
        claims = [("policy", record.policy, policy.digest), ("agent", record.agent, facts.agent)]
        claims += [("task", record.task, facts.task), ("seed", record.seed, facts.seed)]
        claims += [("trained", record.trained, facts.steps if asked is None else facts.steps_at(asked))]
    else:
        claims = []
    for key, said, found in claims:
        if said != found:
            raise ArtefactError(
                f"{folder / RECORD}: `{key}` is {said!r}, but its lineage says {found!r}; evaluate again"
            )


def _episodes(folder: Path, record: Scores) -> tuple[tuple[str, ...], np.ndarray, float]:
    """Ids of the puzzles, rewards (puzzles, N) with zeros behind an episode's end, and actions an episode."""
    rows, budget = read_episodes(folder), step_budget(record.task)
    fixed = [puzzle_id(record.task, record.split, i) for i in range(PER_SET)]
    ids = [row["puzzle"] for row in rows]
    first = fixed.index(ids[0]) if ids and ids[0] in fixed else 0
    if not ids or ids != fixed[first : first + len(ids)]:
        raise ArtefactError(
            f"{folder / EPISODES}: not the {record.split} puzzles of {record.task}, each once and in order; "
            "evaluate again"
        )
    rewards = np.zeros((len(rows), budget))
    for i, row in enumerate(rows):
        try:
            rewards[i, : len(row["rewards"])] = row["rewards"]
        except (ValueError, TypeError) as error:
            raise ArtefactError(f"{folder / EPISODES}: row {i}: not rewards of {budget} actions ({error})") from None
    if not np.isfinite(rewards).all():
        raise ArtefactError(f"{folder / EPISODES}: rewards that are not finite; evaluate again")
    return tuple(ids), rewards, float(np.mean([len(row["rewards"]) for row in rows]))


def _probe(folder: Path) -> Probe:
    digest = artefacts.verify(folder, "probe")
    return Probe(folder, digest, artefacts.lineage(folder), _decode(folder / PROBE, dict[str, Any]))


def _decode(path: Path, kind: Any) -> Any:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path}: not readable: {error}; make the artefact again") from None


def _without_set_aside(runs: list[Run]) -> tuple[list[Run], int]:
    kept, aside = dict[tuple[str, str, str, int], Run](), 0
    for run in sorted(runs, key=lambda run: (len(run.folder.name), str(run.folder))):
        if any(_is_set_aside(run, newer) for newer in kept.values()):
            aside += 1
            continue
        first = kept.setdefault(run.identity, run)
        if first is not run and not _is_same(run, first):
            task, name, seed, trained = run.identity
            raise ArtefactError(
                f"{run.folder} and {first.folder}: both are scores of {name} on {task}, seed {seed}, {trained:,} steps"
                "; give folders that hold only one of them, or, if they are different agents, train them with names of "
                "their own (`gym-open train policy --agent NAME`)"
            )
    return list(kept.values()), aside


def _is_same(run: Run, first: Run) -> bool:
    """A policy's end is one of its checkpoints, perhaps, and was scored as both."""
    return run.record.policy == first.record.policy and np.array_equal(run.returns, first.returns)


def _is_set_aside(run: Run, newer: Run) -> bool:
    """Whether `newer` took the place of `run`, which has another name since: of a policy of other length, perhaps."""
    alike = run.identity[:3] == newer.identity[:3] and not _is_same(run, newer)
    other = run.trained == newer.trained or run.record.policy != newer.record.policy
    name, beside = run.folder.name, run.folder.parent == newer.folder.parent
    return alike and other and beside and re.fullmatch(re.escape(newer.folder.name) + r"-\d+", name) is not None
