"""The world: table, objects, puzzles, tasks, physics, observation and Gymnasium ids. Knows nothing of learning."""
