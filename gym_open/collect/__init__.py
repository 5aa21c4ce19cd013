"""Stage 1: explorers act in the sandbox without a task, and every step is logged."""
