"""Names and order of agents: reports, figures and recordings use the same."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from gym_open import artefacts
from gym_open.envs.puzzles.sets import PER_SET
from gym_open.formats.scores import Scores
from gym_open.results.paper import PAPER, paper_name
from gym_open.terminal import printable

UNTRAINED = ("random", "oracle", "human")
"""Agents that were not trained."""
_SIMULATOR_STATE = "state"
"""Word in the name of an agent that sees the simulator state instead of images."""
_LONGEST, _LONGEST_LABEL = 80, 40
"""Characters of a name in a report, and of a label in a figure."""
_MAX_STEPS = 2**53
"""No policy of gym-open was trained for more steps."""


def one_line(text: str) -> str:
    """Return text from a file on one line, with hidden characters made visible, cut after 80 characters."""
    shown = printable(text).replace("\n", " ")
    return shown if len(shown) <= _LONGEST else f"{shown[:_LONGEST]}…"


def standing(name: str) -> int:
    """Return the group of an agent: 0 is compared, 1 sees the simulator state, then random, oracle and human."""
    first = name.partition(",")[0]
    if first in UNTRAINED:
        return 2 + UNTRAINED.index(first)
    return int(_SIMULATOR_STATE in re.findall("[a-z]+", name.lower()))


def is_trained(name: str) -> bool:
    """Whether an agent of that name was trained, on images or on the simulator state."""
    return standing(name) < 2


def row_order(name: str) -> tuple[int, int, str]:
    """Sort key of agents: by group; within a group the paper's agents in the paper's order, then others by name."""
    paper = paper_name(name)
    return standing(name), list(PAPER).index(paper) if paper else len(PAPER), name


def row_name(record: Scores, puzzles: Sequence[str]) -> str:
    """Return the agent's name, with what separates these scores from other scores of the agent."""
    parts = [_agent(record)]
    if len(puzzles) < PER_SET:
        first, last = (puzzle.rpartition("/")[2] for puzzle in (puzzles[0], puzzles[-1]))
        parts.append(f"puzzles {first}–{last}")
    return one_line(", ".join(parts))


def _agent(record: Scores) -> str:
    return f"{record.agent}, greedy" if record.actions == "greedy" else record.agent


def distinct_names(sources: Mapping[Path, Scores | None]) -> dict[Path, str]:
    """Name each scores artefact (given with its record) and each policy (given with None); no two names are equal.

    The name is the agent's. If several sources have the same agent, the seed is added, then the steps of training,
    then the folder. Text from files is made printable.
    """
    facts = {source: _facts(source, record) for source, record in sources.items()}
    names = {source: own[0] for source, own in facts.items()}
    for i in range(1, 4):
        same = {name: {facts[source][i] for source in names if names[source] == name} for name in names.values()}
        names = {
            source: f"{name}, {facts[source][i]}" if len(same[name]) > 1 else name for source, name in names.items()
        }
    names = {source: printable(name)[:_LONGEST_LABEL] for source, name in names.items()}
    count = Counter[str]()
    for source, name in names.items():
        count[name] += 1
        names[source] = name if count[name] == 1 else f"{name} ({count[name]})"
    return names


def _facts(source: Path, record: Scores | None) -> tuple[str, str, str, str]:
    """Return agent, seed, steps and folder as words."""
    known = artefacts.lineage(source).facts
    agent, seed, steps = known.get("agent", "policy"), known.get("seed"), known.get("steps")
    if record:
        agent, seed, steps = _agent(record), record.seed, record.trained
    player = known.get("player")
    name = f"{agent} {player}" if player else f"{agent}"
    return name, "" if seed is None else f"seed {seed}", _thousands(steps), source.resolve().name


def _thousands(steps: object) -> str:
    """Return `502k steps`, or the whole number if it is small."""
    if not isinstance(steps, int) or not 0 < steps <= _MAX_STEPS:
        return ""
    return f"{steps / 1000:.0f}k steps" if steps >= 10_000 else f"{steps} steps"
