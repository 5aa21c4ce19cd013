"""What agents are called side by side, and their colours."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from gym_open import artefacts
from gym_open.formats.scores import Scores
from gym_open.terminal import printable

COLOURS: tuple[str, ...] = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999")
"""Told apart by colour-blind readers (Okabe and Ito); the ninth agent has the first one's again."""
STYLES: tuple[str, ...] = ("-", "--", "-.", ":")
"""Of lines, as matplotlib has them: colour is not all that tells agents apart."""
_MAX = 40
"""Characters of a name."""
_MAX_STEPS = 2**53
"""A policy that says more was not made by gym-open."""


def colour(number: int) -> tuple[int, int, int]:
    """Red, green and blue (0–255) of the agent with this number."""
    text = COLOURS[number % len(COLOURS)]
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)


def agent_names(sources: Mapping[Path, Scores | None]) -> dict[Path, str]:
    """A name for each scores artefact, whose record is given, and each policy, which has none; no two are the same.

    It is the agent's, with what tells it from the others if that is needed: its seed, then the steps that it was
    trained for, then its folder. What comes from files is made printable.
    """
    facts = {source: _facts(source, record) for source, record in sources.items()}
    names = {source: own[0] for source, own in facts.items()}
    for i in range(1, 4):
        same = {name: {facts[source][i] for source in names if names[source] == name} for name in names.values()}
        names = {
            source: f"{name}, {facts[source][i]}" if len(same[name]) > 1 else name for source, name in names.items()
        }
    names = {source: printable(name)[:_MAX] for source, name in names.items()}
    count = Counter[str]()
    for source, name in names.items():
        count[name] += 1
        names[source] = name if count[name] == 1 else f"{name} ({count[name]})"
    return names


def _facts(source: Path, record: Scores | None) -> tuple[str, str, str, str]:
    """Agent, seed, steps and folder, in words."""
    known = artefacts.lineage(source).facts
    agent, seed, steps = known.get("agent", "policy"), known.get("seed"), known.get("steps")
    if record:
        agent, seed, steps = record.agent, record.seed, record.trained
    player = known.get("player")
    name = f"{agent} {player}" if player else f"{agent}"
    return name, "" if seed is None else f"seed {seed}", _thousands(steps), source.resolve().name


def _thousands(steps: object) -> str:
    """As `502k steps`, the whole number if it is small."""
    if not isinstance(steps, int) or not 0 < steps <= _MAX_STEPS:
        return ""
    return f"{steps / 1000:.0f}k steps" if steps >= 10_000 else f"{steps} steps"
