"""The paper's numbers: its table of A-Success (Gan et al. 2021, arXiv 2110.06912, open-paper.tex, `tab:result`).

Means over three training seeds, and the ± below them; the paper does not say whether it is a deviation or an error. The
human row is from two authors. Digits are copied as printed, without the bold print.
"""

import re
from typing import NamedTuple

from gym_open.envs.puzzles import Task


class PaperScore(NamedTuple):
    """A-Success as printed, and the ± below it."""

    mean: float
    deviation: float


_COLUMNS: tuple[Task, ...] = ("goal-seeking", "preferences", "avoidance", "tool-use")


def _row(*cells: tuple[float, float]) -> dict[Task, PaperScore]:
    return {task: PaperScore(*cell) for task, cell in zip(_COLUMNS, cells, strict=True)}


PAPER: dict[str, dict[Task, PaperScore]] = {
    "PPO (From scratch)": _row((0.509, 0.009), (0.351, 0.02), (0.185, 0.01), (0.113, 0.08)),
    "ICM": _row((0.508, 0.016), (0.344, 0.01), (0.176, 0.023), (0.118, 0.013)),
    "ICM + RIDE": _row((0.486, 0.005), (0.367, 0.011), (0.178, 0.019), (0.120, 0.012)),
    "RND": _row((0.470, 0.01), (0.266, 0.02), (0.168, 0.01), (0.106, 0.01)),
    "RND + RIDE": _row((0.509, 0.014), (0.372, 0.0129), (0.179, 0.018), (0.116, 0.008)),
    "CURL + Random": _row((0.149, 0.02), (0.007, 0.05), (0.103, 0.01), (0.045, 0.01)),
    "CURL + RIDE": _row((0.532, 0.006), (0.386, 0.04), (0.191, 0.02), (0.125, 0.02)),
    "Human": _row((0.584, 0.008), (0.588, 0.015), (0.453, 0.025), (0.363, 0.023)),
}
"""By approach, with the paper's names and order, and by task."""
PAPER_STEPS = 1_000_000
"""Steps of fine-tuning behind every row except the human row."""

_WORDS = {
    frozenset({"scratch"}): "PPO (From scratch)",
    frozenset({"human"}): "Human",
    **{frozenset(re.findall("[a-z]+", name.lower())): name for name in list(PAPER)[1:-1]},
}
_KNOWN = frozenset({"counted"}).union(*_WORDS)
"""Words that decide about an agent; `counted` is among them, since RIDE with counts is not in the paper."""


def paper_name(agent: str) -> str | None:
    """Return the paper's row for an agent by the words in its name, or None: `curl+ride offline` is `CURL + RIDE`."""
    return _WORDS.get(frozenset(re.findall("[a-z]+", agent.lower())) & _KNOWN)
