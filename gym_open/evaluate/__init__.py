"""Stage 4: scores of policies on the fixed puzzles, with A-Success and the task-free proof."""

from gym_open.results.metrics import a_success, mean_return_within

__all__ = ["a_success", "mean_return_within"]
