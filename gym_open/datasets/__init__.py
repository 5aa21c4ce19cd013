"""Stage 2: logs become verifiable, reproducible LeRobot releases."""
