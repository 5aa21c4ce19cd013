"""Stage 4: policies are scored on the fixed puzzles; A-Success and the task-free proof."""

from gym_open.results.metrics import a_success, mean_return_within

__all__ = ["a_success", "mean_return_within"]
