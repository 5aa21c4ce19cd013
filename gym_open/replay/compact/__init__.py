"""Simulation of compact releases: their episodes, and a reader that is used like a release."""
