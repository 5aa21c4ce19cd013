"""Check that the runs of one agent differ only in their seeds: nothing else may explain different scores."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from gym_open.artefacts import CONFIG, Parent
from gym_open.errors import ArtefactError
from gym_open.results.names import UNTRAINED, one_line
from gym_open.results.runs import ScoredRun

Configs = Mapping[str, Mapping[str, Any]]
"""Configurations by SHA-256 of their file."""

_FREE = frozenset({"seed", "task", "agent", "threads", "device", "checkpoints"})
"""Keys of a configuration that may differ: the run, its hardware, and when it was scored."""
_NAMES = frozenset({"name", "version", "license", "published"})
"""Keys of a release's configuration that only name it."""
_FACTS = {
    "policy": ("encoder", "transfer", "frozen", "steps"), "encoder": ("world_model", "updates"), "log": ("explorer",),
}  # fmt: skip
"""Facts in the lineage, which can be compared without the configuration."""
_UNSET = "not set"


class _Difference(NamedTuple):
    kind: str
    """Kind of the artefact that differs."""
    field: str
    ours: Any
    theirs: Any


def check_treatments(runs: Sequence[ScoredRun], configs: Configs) -> None:
    """Check that all runs of each row of a report were made in the same way.

    Only configurations that were found are compared; `unchecked` names the rows with missing configurations.

    Raises:
        ArtefactError: if two runs of an agent differ in more than seed and task; names both, the field and the values.
    """
    first: dict[str, ScoredRun] = {}
    for run in runs:
        if run.record.agent in UNTRAINED:
            continue
        other = first.setdefault(run.name, run)
        for kind, field, ours, theirs in _differences(other, run, configs):
            raise ArtefactError(
                f"{other.folder} and {run.folder}: both are scores of an agent called {run.name!r}, but the {kind}'s "
                f"`{field}` is {_shown(ours)} in the first and {_shown(theirs)} in the second: runs of an agent may "
                "differ only in seeds and tasks; train them with names of their own (`gym-open train policy --agent "
                "NAME`), or give folders that hold only one kind"
            )


def unchecked(runs: Sequence[ScoredRun], configs: Configs) -> list[str]:
    """Return the agents with several policies of which some configurations were not found."""
    policies: dict[str, set[str]] = {}
    unseen: set[str] = set()
    for run in runs:
        for _, link in _links(run):
            policies.setdefault(run.name, set()).add(run.lineage.parents[0].digest)
            if _config(link, configs) is None:
                unseen.add(run.name)
    return [name for name, own in policies.items() if len(own) > 1 and name in unseen]


def _differences(one: ScoredRun, other: ScoredRun, configs: Configs) -> Iterator[_Difference]:
    ours, theirs = dict(_links(one)), dict(_links(other))
    both = [(link, theirs[place]) for place, link in ours.items() if place in theirs]
    for a, b in both:
        kind, facts = a.lineage.kind, (a.lineage.facts, b.lineage.facts)
        yield from _unequal(kind, *({key: own.get(key) for key in _FACTS.get(kind, ())} for own in facts))
    if ours.keys() != theirs.keys():
        yield _Difference("policy", "lineage", " ← ".join(ours), " ← ".join(theirs))
    for a, b in both:
        left, right = _config(a, configs), _config(b, configs)
        if left is not None and right is not None and a.digest != b.digest:
            free = _FREE | (_NAMES if a.lineage.kind == "release" else frozenset())
            yield from _unequal(a.lineage.kind, *(dict(_flat(own, free)) for own in (left, right)))


def _links(run: ScoredRun) -> Iterator[tuple[str, Parent]]:
    """Yield the policy and everything that it was made from, each with the kinds on the way to it."""

    def walk(link: Parent, place: str) -> Iterator[tuple[str, Parent]]:
        yield place, link
        for i, parent in enumerate(link.lineage.parents):
            yield from walk(parent, f"{place}/{parent.lineage.kind}{i or ''}")

    for policy in run.lineage.parents:
        yield from walk(policy, policy.lineage.kind)


def _config(link: Parent, configs: Configs) -> Mapping[str, Any] | None:
    entry = link.manifest.get(CONFIG)
    return None if entry is None else configs.get(entry.sha256)


def _flat(config: Mapping[str, Any], free: frozenset[str]) -> Iterator[tuple[str, Any]]:
    """Yield keys and values; the keys of nested tables are joined with points."""
    for key, value in config.items():
        if key in free:
            continue
        if isinstance(value, Mapping):
            yield from ((f"{key}.{inner}", one) for inner, one in _flat(value, frozenset()))
        else:
            yield key, value


def _unequal(kind: str, ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> Iterator[_Difference]:
    for key in sorted(ours.keys() | theirs.keys()):
        if (a := ours.get(key, _UNSET)) != (b := theirs.get(key, _UNSET)):
            yield _Difference(kind, key, a, b)


def _shown(value: Any) -> str:
    return one_line(value if isinstance(value, str) else repr(value))
