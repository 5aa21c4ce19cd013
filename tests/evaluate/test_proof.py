"""The task-free proof over real artefact chains: proven when whole, missing when cut, forged or not task-free."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.envs.puzzles.sets import puzzle_by_id
from gym_open.evaluate.proof import Proof, task_free_proof

CLEAN = {"task": "sandbox", "extrinsic_reward": False, "puzzles": ["0" * 64]}


def _artefact(out: Path, kind: str, parents: list[Path], facts: Mapping[str, Any]) -> Path:
    def work(partial: Path) -> Mapping[str, Any]:
        (partial / "payload").write_text(kind)
        return facts

    return artefacts.build(out, kind=kind, config=Config(), parents=parents, work=work).path


def _policy(root: Path, log_facts: Mapping[str, Any]) -> Path:
    log = _artefact(root / "log", "log", [], log_facts)
    release = _artefact(root / "release", "release", [log], {})
    encoder = _artefact(root / "encoder", "encoder", [release], {})
    return _artefact(root / "policy", "policy", [encoder], {"task": "goal-seeking"})


def _prove(policy: Path) -> Proof:
    return task_free_proof(artefacts.lineage(policy))


def test_a_whole_chain_is_proven_link_by_link(tmp_path: Path) -> None:
    proof = _prove(_policy(tmp_path, CLEAN))
    assert proof.verdict == "proven"
    assert [link.split()[0] for link in proof.chain] == ["encoder", "release", "log"]
    assert proof.chain[2].endswith(artefacts.digest(tmp_path / "log")[:12])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"task": "goal-seeking"}, "played task 'goal-seeking'"),
        ({"extrinsic_reward": True}, "extrinsic reward"),
        ({"extrinsic_reward": None}, "extrinsic reward"),
        ({"puzzles": []}, "does not name its puzzles"),
        ({"puzzles": ["0" * 64, puzzle_by_id("tool-use/017").digest]}, "holds 1 evaluation puzzle"),
        ({"puzzles": ["0" * 64, puzzle_by_id("avoidance/validation/003").digest]}, "holds 1 evaluation puzzle"),
    ],
)
def test_a_log_that_is_not_task_free_is_not_certified(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    proof = _prove(_policy(tmp_path, {**CLEAN, **change}))
    assert proof.verdict == "missing"
    assert any(reason in text for text in proof.reasons)


def test_a_chain_cut_below_the_encoder_is_named(tmp_path: Path) -> None:
    encoder = _artefact(tmp_path / "encoder", "encoder", [], {})
    proof = _prove(_artefact(tmp_path / "policy", "policy", [encoder], {}))
    assert proof.verdict == "missing"
    assert "parents are not recorded" in proof.reasons[0]


def test_a_chain_that_skips_the_release_is_named(tmp_path: Path) -> None:
    log = _artefact(tmp_path / "log", "log", [], CLEAN)
    encoder = _artefact(tmp_path / "encoder", "encoder", [log], {})
    proof = _prove(_artefact(tmp_path / "policy", "policy", [encoder], {}))
    assert proof.verdict == "missing"
    assert "expected a link of kind 'release'" in proof.reasons[0]


@pytest.mark.parametrize("facts", [CLEAN, {**CLEAN, "task": "tool-use"}])
def test_a_release_of_releases_is_followed_to_every_log(tmp_path: Path, facts: Mapping[str, Any]) -> None:
    """Merged, filtered, or appended to: each of the logs below counts."""
    logs = [_artefact(tmp_path / f"log-{i}", "log", [], found) for i, found in enumerate((CLEAN, facts))]
    releases = [_artefact(tmp_path / f"of-{log.name}", "release", [log], {}) for log in logs]
    merged = _artefact(tmp_path / "merged", "release", releases, {})
    encoder = _artefact(tmp_path / "encoder", "encoder", [merged], {})
    proof = _prove(_artefact(tmp_path / "policy", "policy", [encoder], {}))
    assert [link.split()[0] for link in proof.chain] == ["encoder", "release", "release", "log", "release", "log"]
    assert proof.verdict == ("proven" if facts == CLEAN else "missing")


def test_a_forged_fact_breaks_the_chain(tmp_path: Path) -> None:
    policy = _policy(tmp_path, {**CLEAN, "task": "goal-seeking"})
    path = policy / "lineage.json"
    record = json.loads(path.read_text())
    record["parents"][0]["lineage"]["parents"][0]["lineage"]["parents"][0]["lineage"]["facts"]["task"] = "sandbox"
    path.write_bytes(artefacts.canonical_json(record))
    proof = _prove(policy)
    assert proof.verdict == "missing"
    assert any("do not match its digest" in reason for reason in proof.reasons)


def test_without_an_encoder_there_is_nothing_to_prove(tmp_path: Path) -> None:
    assert task_free_proof(None).verdict == "no encoder"
    assert _prove(_artefact(tmp_path / "policy", "policy", [], {})).verdict == "no encoder"
