"""The task-free proof: nothing that an encoder learned from knew of a task, a reward or an evaluation puzzle.

The chain policy → encoder → release → log is walked in the lineage that the policy carries; a release may be made of
other releases, down to their logs. Each link's digest is recomputed from the records in it, so that a record changed
afterwards breaks the chain.
"""

from collections.abc import Iterator
from typing import Literal

import msgspec

from gym_open.artefacts import Lineage, Parent
from gym_open.envs.puzzles.sets import reserved_digests

Verdict = Literal["proven", "no encoder", "missing", "not applicable"]


class Proof(msgspec.Struct, frozen=True):
    """What can be said of a policy's origin.

    `proven`: the whole chain is there and task-free. `no encoder`: nothing was learned before the task.
    `missing`: the chain breaks where `reasons` says, and nothing is certified.
    `not applicable`: what played is no policy.
    """

    verdict: Verdict
    reasons: list[str]
    chain: list[str]
    """A line for each link, from the encoder down to the logs."""


def task_free_proof(policy: Lineage | None) -> Proof:
    """Walk from a policy's lineage down to the logs its encoder was learned from (None: a random agent)."""
    if policy is None or not policy.parents:
        return Proof(verdict="no encoder", reasons=["nothing was learned before the task"], chain=[])
    fixed = reserved_digests()
    reasons: list[str] = []
    chain: list[str] = []
    for parent in policy.parents:
        for line, faults in _walk(parent, ("encoder",), fixed):
            chain.append(line)
            reasons.extend(faults)
    return Proof(verdict="missing" if reasons else "proven", reasons=reasons, chain=chain)


def oracle_proof() -> Proof:
    """What can be said of the oracle: nothing of the kind, since it was made from the very puzzles that it plays."""
    reason = "the oracle replays action sequences that a planner found in these very puzzles, seeing their full state"
    return Proof(verdict="not applicable", reasons=[reason], chain=[])


_BELOW = {"encoder": ("release",), "release": ("log", "release")}


def _walk(link: Parent, expected: tuple[str, ...], fixed: frozenset[str]) -> Iterator[tuple[str, list[str]]]:
    name = f"{link.lineage.kind} {link.digest[:12]}"
    faults = []
    if link.lineage.kind not in expected:
        faults.append(f"{name}: expected a link of kind {' or '.join(map(repr, expected))}")
    if not link.is_consistent():
        faults.append(f"{name}: its records do not match its digest")
    if link.lineage.kind == "log":
        faults += [f"{name}: {fault}" for fault in _faults_of_log(link.lineage.facts, fixed)]
    elif not link.lineage.parents:
        faults.append(f"{name}: its parents are not recorded")
    yield name, faults
    for parent in link.lineage.parents:
        yield from _walk(parent, _BELOW.get(link.lineage.kind, ("log",)), fixed)


def _faults_of_log(facts: dict[str, object], fixed: frozenset[str]) -> Iterator[str]:
    puzzles = facts.get("puzzles")
    if facts.get("task") != "sandbox":
        yield f"played task {facts.get('task')!r}, not the sandbox"
    if facts.get("extrinsic_reward") is not False:
        yield "does not say that extrinsic reward was off"
    if not isinstance(puzzles, list) or not puzzles:
        yield "does not name its puzzles"
    elif shared := fixed & set(puzzles):
        yield f"holds {len(shared)} evaluation puzzle(s), the first with digest {min(shared)[:12]}"
