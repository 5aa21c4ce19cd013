"""Tests, and what they share: draccus installs a package of the same name, so this one says that it is one."""
