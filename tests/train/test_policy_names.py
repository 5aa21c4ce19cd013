"""What a policy's agent is called that was given no name: two treatments have two names."""

from typing import Any

import pytest

from gym_open.agents.config import EncoderConfig
from gym_open.artefacts import Lineage, Parent
from gym_open.config import check
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.policy import _name


def _lineage(kind: str, facts: dict[str, Any], *parents: Lineage) -> Lineage:
    links = [Parent(digest="", manifest={}, lineage=parent) for parent in parents]
    return Lineage(kind=kind, key="", code="", packages={}, facts=facts, parents=links)


LOG = _lineage("log", {"explorer": "curl+ride"})
ENCODER = _lineage("encoder", {"world_model": "icm"}, _lineage("release", {}, LOG))


@pytest.mark.parametrize(
    ("start", "changes", "name"),
    [
        (None, {}, "scratch"),
        (None, {"encoder": EncoderConfig(architecture="state"), "trunk": (8,)}, "state"),
        (None, {"encoder": EncoderConfig(architecture="impala")}, "scratch-impala"),
        (LOG, {}, "curl+ride"),
        (LOG, {"frozen": True}, "curl+ride-frozen"),
        (ENCODER, {}, "curl+ride-offline-icm"),
        (ENCODER, {"transfer": "weights", "frozen": True}, "curl+ride-offline-icm-weights-frozen"),
        (_lineage("log", {}), {}, "unknown-play"),
    ],
)
def test_names_tell_treatments_apart(start: Lineage | None, changes: dict[str, Any], name: str) -> None:
    assert _name(PolicyTrainConfig(**changes), start) == name
    check(PolicyTrainConfig(agent=name), source="the default")  # it can be given, too
