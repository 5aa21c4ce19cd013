"""The task-free proof: an encoder learned from no task, no extrinsic reward and no evaluation puzzle.

The chain policy → encoder → release → log is followed in the lineage of the policy. If a policy starts from an
explorer's own encoder, the log follows the policy directly. A release may be made of other releases, down to their
logs. The digest of each link is recomputed from its records, so a record that was changed later breaks the chain.

No record can show who wrote the records: see `Proof.rests_on`.

The texts of a proof are part of `scores.json`, and `gym-open score verify` compares them: another wording would refuse
all scores that were published before.
"""

from collections.abc import Iterator
from typing import Any

import msgspec

from gym_open.artefacts import Parent, code_version
from gym_open.envs.puzzles.sets import reserved_digests
from gym_open.formats.scores import Proof
from gym_open.results.runs import PolicyFacts

_BELOW = {
    "policy": ("encoder", "log"), "encoder": ("release", "compact"), "compact": ("release",),
    "release": ("log", "release", "compact"), "log": (),
}  # fmt: skip
"""Kinds of parents that each kind of link may have."""
_WEIGHTS = "model.safetensors"
_OWN = f"encoder/{_WEIGHTS}"
"""File in a log: the explorer's encoder at the end."""
_PAYLOAD = {
    "policy": (_WEIGHTS, "model.json"), "encoder": (_WEIGHTS, "model.json"),
    "release": ("meta/info.json",), "compact": ("compact.json",), "log": ("summary.json",),
}  # fmt: skip
"""Files that every artefact of a kind has."""
_LEARNED_FROM = {"none": [], "offline": ["encoder"], "online": ["log"]}
"""Kinds of the parents of a policy, by the fact `encoder`."""


def task_free_proof(policy: Parent | None, *, evaluator: str | None = None) -> Proof:
    """Follow a policy's records down to the logs that its encoder learned from (None: a random agent).

    Args:
        policy: records in a policy's folder, or the parent in the lineage of its scores; they are the same.
        evaluator: version of the code that scored the policy; by default this version.
    """
    evaluator = evaluator or code_version("scores")
    if policy is None:
        return Proof(verdict="no encoder", reasons=["nothing was learned at all"], chain=[])
    reasons: list[str] = []
    chain: list[str] = []
    for line, faults in _walk(policy, ("policy",)):
        chain.append(line)
        reasons.extend(faults)
    if reasons:
        return Proof(verdict="missing", reasons=reasons, chain=chain)
    if not policy.lineage.parents:
        reasons = ["nothing was learned before the task"]
        return Proof(verdict="no encoder", reasons=reasons, chain=chain, rests_on=_own_training(policy, evaluator))
    trust = (
        f"Every record matches the digest that names it, up to the policy's, {policy.digest}: whoever writes all of "
        "them anew has a policy of another digest, so compare it with the one that was published. That the weights "
        "came of these links is the word of who trained them: the same commands on the same type of machine give the "
        "same bytes, and `gym-open dataset verify` and `gym-open log replay` play again what was learned from. "
    )
    return Proof(verdict="proven", reasons=[], chain=chain, rests_on=trust + _own_training(policy, evaluator))


def oracle_proof() -> Proof:
    """Return the proof of the oracle, which does not apply: the oracle was made from the puzzles that it plays."""
    reason = "the oracle replays action sequences that a planner found in these very puzzles, seeing their full state"
    return Proof(verdict="not applicable", reasons=[reason], chain=[])


def human_proof() -> Proof:
    """Return the proof of a person: there is no encoder."""
    return Proof(verdict="no encoder", reasons=["a person played: no policy, and nothing learned from logs"], chain=[])


def _own_training(policy: Parent, evaluator: str) -> str:
    return (
        f"The puzzles that the policy was trained on were drawn by code {policy.lineage.code}; the generator of code "
        f"{evaluator}, which evaluated it, never gives one of the {len(reserved_digests())} evaluation layouts."
    )


def _walk(link: Parent, expected: tuple[str, ...]) -> Iterator[tuple[str, list[str]]]:
    kind = link.lineage.kind
    name = f"{kind} {link.digest[:12]}"
    faults = []
    if kind not in expected:
        kinds = " or ".join(map(repr, expected)) or "nothing: a log is where the chain ends"
        faults.append(f"{name}: expected {'a link of kind ' if expected else ''}{kinds}")
    if not link.is_consistent():
        faults.append(f"{name}: its records do not match its digest")
    faults += [f"{name}: {fault}" for fault in (*_faults_of_payload(link), *_FAULTS.get(kind, _none)(link))]
    yield name, faults
    for parent in link.lineage.parents:
        yield from _walk(parent, _BELOW.get(kind, ()))


def _none(_: Parent) -> Iterator[str]:
    yield from ()


def _faults_of_payload(link: Parent) -> Iterator[str]:
    for file in _PAYLOAD.get(link.lineage.kind, ()):
        if file not in link.manifest:
            yield f"its manifest has no {file}, so it is no {link.lineage.kind}"


def _faults_of_policy(link: Parent) -> Iterator[str]:
    try:
        facts = msgspec.convert(link.lineage.facts, PolicyFacts)
    except msgspec.ValidationError as error:
        yield f"its facts are not those of a policy ({error})"
        return
    parents = link.lineage.parents
    kinds = [parent.lineage.kind for parent in parents]
    if kinds != _LEARNED_FROM[facts.encoder] or facts.from_encoder is not bool(parents):
        yield f"its facts say {facts.encoder!r} of its encoder, its records have {kinds or 'none'}"
    if facts.encoder == "online" and any(_OWN not in parent.manifest for parent in parents):
        yield "the log that it started from holds no encoder"


def _faults_of_encoder(link: Parent) -> Iterator[str]:
    if not link.lineage.parents:
        yield "its parents are not recorded"
    for fact in sorted({"task", "extrinsic_reward"} & link.lineage.facts.keys()):
        yield f"its facts name {fact!r}, as no encoder's do: it learned something else"


def _faults_of_release(link: Parent) -> Iterator[str]:
    if not link.lineage.parents:
        yield "its parents are not recorded"
    held = _words(link.lineage.facts.get("logs"))
    if not held:
        yield "does not name the logs whose steps it holds"
        return
    if hidden := sorted(held - set(_logs(link))):
        yield f"holds steps of {len(hidden)} log(s) that are not in its records, the first {hidden[0][:12]}"
    own = {parent.digest for parent in link.lineage.parents if parent.lineage.kind == "log"}
    if unnamed := sorted(own - held):
        yield f"made of {len(unnamed)} log(s) that it does not name, the first {unnamed[0][:12]}"


def _faults_of_compact(link: Parent) -> Iterator[str]:
    if len(link.lineage.parents) != 1:
        yield "the release that was packed is not recorded"


def _logs(link: Parent) -> Iterator[str]:
    if link.lineage.kind == "log":
        yield link.digest
    for parent in link.lineage.parents:
        yield from _logs(parent)


def _faults_of_log(link: Parent) -> Iterator[str]:
    facts = link.lineage.facts
    if not any(file.endswith(".mcap") for file in link.manifest):
        yield "its manifest has no .mcap file, so it is no log"
    if facts.get("task") != "sandbox":
        yield f"played task {facts.get('task')!r}, not the sandbox"
    if facts.get("extrinsic_reward") is not False:
        yield "does not say that extrinsic reward was off"
    puzzles = _words(facts.get("puzzles"))
    if not puzzles:
        yield "does not name its puzzles"
    elif shared := reserved_digests() & puzzles:
        yield f"holds {len(shared)} evaluation puzzle(s), the first with digest {min(shared)[:12]}"


def _words(value: Any) -> set[str]:
    """Return the texts in a list; an empty set if it is no list, or has anything else."""
    return set(value) if isinstance(value, list) and all(isinstance(item, str) for item in value) else set()


_FAULTS = {
    "policy": _faults_of_policy, "encoder": _faults_of_encoder, "release": _faults_of_release,
    "compact": _faults_of_compact, "log": _faults_of_log,
}  # fmt: skip
