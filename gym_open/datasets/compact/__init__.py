"""Compact releases: pack a release as its actions, restore it to the bit, verify it."""
