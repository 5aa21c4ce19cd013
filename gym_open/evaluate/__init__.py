"""Stage 4: policies are scored on the fixed puzzles; A-Success and the task-free proof."""
