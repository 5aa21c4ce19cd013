"""The task-free proof on real chains of artefacts: proven if whole, missing if broken, forged or not task-free."""

import hashlib
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.artefacts import Entry, Lineage, Parent
from gym_open.config import Config
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import TASKS, Puzzle, Task, generators
from gym_open.envs.puzzles.sets import puzzle_by_id, puzzles_of, reserved_digests
from gym_open.evaluate.proof import oracle_proof, task_free_proof
from gym_open.formats.scores import Proof
from gym_open.train.environments import TrainingEnvironments

CLEAN = {"task": "sandbox", "extrinsic_reward": False, "puzzles": ["0" * 64]}
MODEL = ("model.safetensors", "model.json", "curve.json")
FILES = {
    "log": ("stream-000-000.mcap", "summary.json", "encoder/model.safetensors"),
    "release": ("meta/info.json", "data/chunk-000/file-000.parquet"),
    "encoder": MODEL,
    "policy": MODEL,
}
FROM = {None: "none", "encoder": "offline", "log": "online", "policy": "offline"}


def artefact(
    out: Path, kind: str, parents: Sequence[Path] = (), facts: Mapping[str, Any] | None = None,
    files: Sequence[str] | None = None,
) -> Path:  # fmt: skip
    def work(partial: Path) -> Mapping[str, Any]:
        for name in FILES[kind] if files is None else files:
            (partial / name).parent.mkdir(parents=True, exist_ok=True)
            (partial / name).write_text(f"{kind} {name}")
        return facts or {}

    return artefacts.build(out, kind=kind, config=Config(), parents=parents, work=work).path


def release_of(out: Path, parents: Sequence[Path], held: Sequence[Path]) -> Path:
    return artefact(out, "release", parents, {"logs": [artefacts.digest(log) for log in held]})


def policy_of(out: Path, start: Path | None, **facts: Any) -> Path:
    kind = artefacts.lineage(start).kind if start else None
    said = {
        "task": "goal-seeking", "steps": 64, "agent": "x", "seed": 0, "checkpoints": [], "encoder": FROM[kind],
        "from_encoder": start is not None, **facts,
    }  # fmt: skip
    return artefact(out, "policy", [start] if start else [], said)


def whole_chain(root: Path, log_facts: Mapping[str, Any] = CLEAN, **facts: Any) -> Path:
    log = artefact(root / "log", "log", [], log_facts)
    encoder = artefact(root / "encoder", "encoder", [release_of(root / "release", [log], [log])])
    return policy_of(root / "policy", encoder, **facts)


def records(policy: Path) -> Parent:
    return Parent(artefacts.digest(policy), artefacts.manifest(policy), artefacts.lineage(policy))


def prove(policy: Path) -> Proof:
    return task_free_proof(records(policy))


def assert_missing(proof: Proof, reason: str) -> None:
    assert proof.verdict == "missing"
    assert any(reason in text for text in proof.reasons), proof.reasons


# What can be written by somebody who makes every record above a change anew -------------------------------------------

Change = Callable[[dict[str, Any]], None]
"""Of a link, as plain data: kind, key, code, packages, facts, parents."""


def resealed(link: Parent, path: Sequence[int], change: Change) -> Parent:
    """Change the lineage that `path` (indices of parents) leads to, and compute all digests again."""
    lineage = link.lineage
    if path:
        first, *rest = path
        parents = [resealed(p, rest, change) if i == first else p for i, p in enumerate(lineage.parents)]
        found = {**_plain(lineage), "parents": parents}
    else:
        found = _plain(lineage)
        change(found)
    return sealed(Lineage(**found), link.manifest)


def sealed(lineage: Lineage, manifest: Mapping[str, Entry]) -> Parent:
    """A parent whose digest, manifest and lineage fit."""
    data = artefacts.canonical_json(lineage)
    listed = {**manifest, artefacts.LINEAGE: Entry(_sha256(data), len(data))}
    return Parent(_sha256(artefacts.canonical_json(listed)), listed, lineage)


def _plain(lineage: Lineage) -> dict[str, Any]:
    return {name: getattr(lineage, name) for name in lineage.__struct_fields__}


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def set_facts(**facts: Any) -> Change:
    return lambda found: found.update(facts={**found["facts"], **facts})


# ----------------------------------------------------------------------------------------------------------------------


def test_a_whole_chain_is_proven_link_by_link(tmp_path: Path) -> None:
    proof = prove(whole_chain(tmp_path))
    assert proof.verdict == "proven"
    assert not proof.reasons
    assert proof.chain == [
        f"{kind} {artefacts.digest(tmp_path / kind)[:12]}" for kind in ("policy", "encoder", "release", "log")
    ]
    assert artefacts.digest(tmp_path / "policy") in proof.rests_on


def test_an_explorers_own_encoder_is_proven_from_its_log(tmp_path: Path) -> None:
    log = artefact(tmp_path / "log", "log", [], CLEAN)
    proof = prove(policy_of(tmp_path / "policy", log))
    assert proof.verdict == "proven"
    assert [link.split()[0] for link in proof.chain] == ["policy", "log"]


def test_a_log_without_an_encoder_is_nothing_to_start_from(tmp_path: Path) -> None:
    bare = artefact(tmp_path / "log", "log", [], CLEAN, ("stream-000-000.mcap", "summary.json"))
    assert_missing(prove(policy_of(tmp_path / "policy", bare)), "the log that it started from holds no encoder")


@pytest.mark.parametrize("name", ["random", "oracle", "human"])
def test_a_policy_under_the_name_of_what_is_none_is_no_policy(tmp_path: Path, name: str) -> None:
    assert_missing(prove(policy_of(tmp_path / "policy", None, agent=name)), "its facts are not those of a policy")
    assert prove(policy_of(tmp_path / "other", None, agent=f"{name}-2")).verdict == "no encoder"


def test_without_an_encoder_there_is_nothing_to_prove(tmp_path: Path) -> None:
    assert task_free_proof(None).verdict == "no encoder"
    proof = prove(policy_of(tmp_path / "policy", None))
    assert proof.verdict == "no encoder"
    assert "800 evaluation layouts" in proof.rests_on
    assert oracle_proof().verdict == "not applicable"


NOT_TASK_FREE = [
    ({"task": "goal-seeking"}, "played task 'goal-seeking'"),
    ({"task": None}, "played task None"),
    ({"extrinsic_reward": True}, "extrinsic reward"),
    ({"extrinsic_reward": None}, "extrinsic reward"),
    ({"extrinsic_reward": 0}, "extrinsic reward"),
    ({"puzzles": []}, "does not name its puzzles"),
    ({"puzzles": [["0" * 64]]}, "does not name its puzzles"),
    ({"puzzles": "0" * 64}, "does not name its puzzles"),
    ({"puzzles": ["0" * 64, puzzle_by_id("tool-use/017").digest]}, "holds 1 evaluation puzzle"),
    ({"puzzles": ["0" * 64, puzzle_by_id("avoidance/validation/003").digest]}, "holds 1 evaluation puzzle"),
]


@pytest.mark.parametrize(("change", "reason"), NOT_TASK_FREE)
def test_a_log_that_is_not_task_free_is_not_certified(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    assert_missing(prove(whole_chain(tmp_path, {**CLEAN, **change})), reason)


def test_a_log_with_an_encoder_of_its_own_must_be_task_free_too(tmp_path: Path) -> None:
    log = artefact(tmp_path / "log", "log", [], {**CLEAN, "extrinsic_reward": True})
    assert_missing(prove(policy_of(tmp_path / "policy", log)), "extrinsic reward")


@pytest.mark.parametrize("facts", [CLEAN, {**CLEAN, "task": "tool-use"}])
def test_a_release_of_releases_is_followed_to_every_log(tmp_path: Path, facts: Mapping[str, Any]) -> None:
    """Merged, filtered or appended: every log below counts."""
    logs = [artefact(tmp_path / f"log-{i}", "log", [], found) for i, found in enumerate((CLEAN, facts))]
    releases = [release_of(tmp_path / f"of-{log.name}", [log], [log]) for log in logs]
    merged = release_of(tmp_path / "merged", releases, logs)
    proof = prove(policy_of(tmp_path / "policy", artefact(tmp_path / "encoder", "encoder", [merged])))
    kinds = [link.split()[0] for link in proof.chain]
    assert kinds == ["policy", "encoder", "release", "release", "log", "release", "log"]
    assert proof.verdict == ("proven" if facts == CLEAN else "missing")


# Cut ------------------------------------------------------------------------------------------------------------------


def test_an_encoder_of_no_release_is_cut(tmp_path: Path) -> None:
    encoder = artefact(tmp_path / "encoder", "encoder")
    assert_missing(prove(policy_of(tmp_path / "policy", encoder)), "encoder " + artefacts.digest(encoder)[:12])
    assert_missing(prove(tmp_path / "policy"), "its parents are not recorded")


def test_a_release_of_no_log_is_cut(tmp_path: Path) -> None:
    encoder = artefact(tmp_path / "encoder", "encoder", [artefact(tmp_path / "release", "release", [], {"logs": []})])
    assert_missing(prove(policy_of(tmp_path / "policy", encoder)), "its parents are not recorded")


def test_a_chain_that_skips_the_release_is_named(tmp_path: Path) -> None:
    encoder = artefact(tmp_path / "encoder", "encoder", [artefact(tmp_path / "log", "log", [], CLEAN)])
    assert_missing(prove(policy_of(tmp_path / "policy", encoder)), "expected a link of kind 'release'")


def test_a_log_is_where_a_chain_ends(tmp_path: Path) -> None:
    """Refused: an explorer that began with a network trained on a task."""
    other = policy_of(tmp_path / "other", None)
    proof = prove(policy_of(tmp_path / "policy", artefact(tmp_path / "log", "log", [other], CLEAN)))
    assert_missing(proof, "a log is where the chain ends")


def test_a_policy_that_goes_on_from_a_policy_is_not_certified(tmp_path: Path) -> None:
    proof = prove(policy_of(tmp_path / "policy", policy_of(tmp_path / "other", None)))
    assert_missing(proof, "expected a link of kind 'encoder' or 'log'")


@pytest.mark.parametrize("kind", ["encoder", "release", "log", "policy"])
def test_what_lacks_the_files_of_its_kind_is_none(tmp_path: Path, kind: str) -> None:
    link = records(whole_chain(tmp_path))
    path = {"policy": [], "encoder": [0], "release": [0, 0], "log": [0, 0, 0]}[kind]

    def without_files(link: Parent, path: Sequence[int]) -> Parent:
        if not path:
            return sealed(link.lineage, {artefacts.CONFIG: Entry("0" * 64, 2)})
        parents = [without_files(link.lineage.parents[0], path[1:])]
        return sealed(Lineage(**{**_plain(link.lineage), "parents": parents}), link.manifest)

    assert_missing(task_free_proof(without_files(link, path)), f"so it is no {kind}")


# Forged, and nothing made anew ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("depth", "field", "value"),
    [
        (3, "facts", CLEAN), (3, "kind", "release"), (2, "parents", []), (1, "parents", []), (1, "code", "0.0.0"),
        (2, "facts", {"logs": []}), (3, "packages", {}), (2, "key", "0"),
    ],
)  # fmt: skip
def test_a_record_that_was_changed_breaks_the_chain(tmp_path: Path, depth: int, field: str, value: Any) -> None:
    policy = whole_chain(tmp_path, {**CLEAN, "task": "goal-seeking"})
    path = policy / artefacts.LINEAGE
    record = json.loads(path.read_text())
    link = record
    for _ in range(depth):
        link = link["parents"][0]["lineage"]
    link[field] = value
    path.write_bytes(artefacts.canonical_json(record))
    assert_missing(prove(policy), "do not match its digest")


def test_a_swapped_parent_breaks_the_chain(tmp_path: Path) -> None:
    """With another encoder's lineage, every link is consistent, but the policy's digest does not match."""
    dirty = records(whole_chain(tmp_path / "dirty", {**CLEAN, "task": "tool-use"}))
    clean = records(whole_chain(tmp_path / "clean"))
    swapped = Parent(dirty.digest, dirty.manifest, clean.lineage)
    assert_missing(task_free_proof(swapped), "do not match its digest")
    inner = Parent(dirty.lineage.parents[0].digest, dirty.lineage.parents[0].manifest, clean.lineage.parents[0].lineage)
    forged = sealed(Lineage(**{**_plain(dirty.lineage), "parents": [inner]}), dirty.manifest)
    assert_missing(task_free_proof(forged), f"encoder {inner.digest[:12]}: its records do not match its digest")


# Forged, and every digest above made anew: what records still give away -----------------------------------------------


@pytest.mark.parametrize(
    ("path", "change", "reason"),
    [
        ([], set_facts(encoder="none", from_encoder=False), "its facts say 'none' of its encoder"),
        ([], lambda found: found.update(parents=[]), "its facts say 'offline' of its encoder, its records have none"),
        ([], set_facts(encoder="online"), "its facts say 'online' of its encoder, its records have ['encoder']"),
        ([], set_facts(from_encoder=False), "its facts say 'offline' of its encoder, its records have ['encoder']"),
        ([], lambda found: found.update(facts={}), "its facts are not those of a policy"),
        ([], lambda found: found.update(parents=found["parents"] * 2), "its records have ['encoder', 'encoder']"),
        ([], lambda found: found.update(kind="encoder"), "expected a link of kind 'policy'"),
        ([0], lambda found: found.update(parents=[]), "its parents are not recorded"),
        ([0], lambda found: found.update(kind="log", facts=CLEAN), "its manifest has no .mcap file, so it is no log"),
        ([0], lambda found: found.update(kind="release"), "its manifest has no meta/info.json, so it is no release"),
        ([0], set_facts(task="goal-seeking", steps=64), "its facts name 'task', as no encoder's do"),
        ([0, 0], lambda found: found.update(parents=[]), "its parents are not recorded"),
        ([0, 0], lambda found: found.update(facts={}), "does not name the logs whose steps it holds"),
        ([0, 0], set_facts(logs=["f" * 64]), "holds steps of 1 log(s) that are not in its records, the first ffffff"),
        ([0, 0], set_facts(logs=[]), "does not name the logs whose steps it holds"),
        ([0, 0, 0], lambda found: found.update(kind="scores"), "expected a link of kind 'log' or 'release'"),
    ],
)  # fmt: skip
def test_a_chain_that_was_made_anew_must_still_fit_together(
    tmp_path: Path, path: list[int], change: Change, reason: str
) -> None:
    assert_missing(task_free_proof(resealed(records(whole_chain(tmp_path)), path, change)), reason)


def test_a_release_that_hides_a_log_is_found(tmp_path: Path) -> None:
    """A release of a clean log and of a log with a task, whose record was removed; all digests are computed again."""
    clean = artefact(tmp_path / "clean", "log", [], CLEAN)
    dirty = artefact(tmp_path / "dirty", "log", [], {**CLEAN, "task": "tool-use"})
    release = release_of(tmp_path / "release", [clean, dirty], [clean, dirty])
    policy = policy_of(tmp_path / "policy", artefact(tmp_path / "encoder", "encoder", [release]))
    forged = resealed(records(policy), [0, 0], lambda found: found.update(parents=found["parents"][:1]))
    assert_missing(task_free_proof(forged), f"the first {artefacts.digest(dirty)[:12]}")


def test_a_log_that_no_release_says_it_holds_is_named(tmp_path: Path) -> None:
    logs = [artefact(tmp_path / f"log-{i}", "log", [], {**CLEAN, "steps": i}) for i in range(2)]
    release = release_of(tmp_path / "release", logs, logs[:1])
    proof = prove(policy_of(tmp_path / "policy", artefact(tmp_path / "encoder", "encoder", [release])))
    assert_missing(proof, f"made of 1 log(s) that it does not name, the first {artefacts.digest(logs[1])[:12]}")


def test_what_is_consistent_throughout_is_told_apart_by_its_digest_alone(tmp_path: Path) -> None:
    """Records cannot show this, so the proof says what it rests on: the policy's digest, which a forgery changes."""
    honest = records(whole_chain(tmp_path, {**CLEAN, "task": "goal-seeking"}))
    forged = resealed(honest, [0, 0, 0], set_facts(task="sandbox"))
    held = forged.lineage.parents[0].lineage.parents[0].lineage.parents[0].digest
    forged = resealed(forged, [0, 0], set_facts(logs=[held]))
    proof = task_free_proof(forged)
    assert proof.verdict == "proven"
    assert forged.digest != honest.digest
    assert forged.digest in proof.rests_on
    assert "published" in proof.rests_on


# The policy's own puzzles ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_training_never_sees_an_evaluation_puzzle(task: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if a broken generator draws one every other time."""
    drawn, seen = [], set[str]()
    wrong = itertools.cycle([*puzzles_of(task, "test"), *puzzles_of(task, "validation")])
    honest, load = generators.draw_layout, OpenEnv._load

    def draw_layout(*arguments: Any) -> Puzzle:
        drawn.append(next(wrong) if len(drawn) % 2 == 0 else honest(*arguments))
        return drawn[-1]

    def watched(env: OpenEnv, puzzle: Puzzle) -> None:
        seen.add(puzzle.digest)
        load(env, puzzle)

    monkeypatch.setattr(generators, "draw_layout", draw_layout)
    monkeypatch.setattr(OpenEnv, "_load", watched)
    TrainingEnvironments(task, 8, seed=3)
    assert sum(puzzle.digest in reserved_digests() for puzzle in drawn) == 8
    assert len(seen) == 8
    assert seen.isdisjoint(reserved_digests())
