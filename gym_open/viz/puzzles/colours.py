"""Colours and line styles of agents."""

COLOURS: tuple[str, ...] = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999")
"""Told apart by colour-blind readers (Okabe and Ito); the ninth agent has the first one's again."""
STYLES: tuple[str, ...] = ("-", "--", "-.", ":")
"""Of lines, as matplotlib has them: colour is not all that tells agents apart."""


def colour(number: int) -> tuple[int, int, int]:
    """Red, green and blue (0–255) of the agent with this number."""
    text = COLOURS[number % len(COLOURS)]
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)
