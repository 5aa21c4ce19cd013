"""Provenance, read by in-toto's own library."""

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gym_open import artefacts
from gym_open.datasets import Release
from gym_open.datasets.config import ReleaseConfig
from gym_open.datasets.documents.provenance import statement
from gym_open.formats.releases.layout import RECORDS


@pytest.fixture(scope="module")
def said(release: Release) -> dict[str, Any]:
    return msgspec.json.decode((release.root / "provenance.json").read_bytes())


def test_it_is_a_statement_of_in_toto_with_a_predicate_of_slsa(said: dict[str, Any]) -> None:
    from google.protobuf import json_format
    from in_toto_attestation.predicates.provenance.v1 import provenance_pb2
    from in_toto_attestation.v1 import statement_pb2
    from in_toto_attestation.v1.statement import Statement

    parsed = statement_pb2.Statement()  # pyright: ignore[reportAttributeAccessIssue]
    json_format.ParseDict(said, parsed)  # refuses a field that the schema does not have
    Statement.copy_from_pb(parsed).validate()
    predicate = provenance_pb2.Provenance()  # pyright: ignore[reportAttributeAccessIssue]
    json_format.ParseDict(said["predicate"], predicate)
    assert said["predicateType"] == "https://slsa.dev/provenance/v1"
    assert predicate.build_definition.build_type
    assert predicate.run_details.builder.id
    for item in predicate.build_definition.resolved_dependencies:
        assert re.fullmatch(r"[0-9a-f]{64}", item.digest["sha256"])


def test_subjects_are_the_payload(said: dict[str, Any], release: Release) -> None:
    manifest = artefacts.manifest(release.root)
    expected = {name: entry.sha256 for name, entry in manifest.items() if name not in RECORDS}
    assert {item["name"]: item["digest"]["sha256"] for item in said["subject"]} == expected


def test_it_names_inputs_seeds_code_and_packages(said: dict[str, Any], release: Release, logs: list[Path]) -> None:
    build = said["predicate"]["buildDefinition"]
    inputs = [item["digest"]["sha256"] for item in build["resolvedDependencies"]]
    assert inputs == [artefacts.digest(log) for log in logs]
    assert build["externalParameters"]["config"]["max_episode_steps"] == 5
    assert build["internalParameters"]["seeds"] == {"release": "7", "streams": ["0", "0", "1"]}
    run = said["predicate"]["runDetails"]
    assert run["builder"]["version"]["gym-open"] == artefacts.lineage(release.root).code
    assert {"matplotlib", "pillow", "pyarrow", "mujoco"} <= set(run["builder"]["version"])
    assert run["metadata"] == {"finishedOn": "2026-02-03T00:00:00Z"}


def test_without_a_day_of_publication_there_is_no_date(release: Release, logs: list[Path]) -> None:
    text = msgspec.json.encode(statement(release.root, ReleaseConfig(), logs, "build")).decode()
    assert "metadata" not in text
    assert not re.search(r"20\d\d-\d\d", text)
    assert str(logs[0].parent) not in text
