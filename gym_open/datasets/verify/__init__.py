"""Verifying releases: every byte, how the parts fit together, every frame, and a replay. docs/verifying.md has more."""

from gym_open.artefacts import Problem
from gym_open.datasets.verify.report import Check, VerificationReport
from gym_open.datasets.verify.run import verify_release

__all__ = ["Check", "Problem", "VerificationReport", "verify_release"]
