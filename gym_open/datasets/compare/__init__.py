"""Find what changed between two releases, and the version that follows from it."""
