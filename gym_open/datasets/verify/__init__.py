"""Verify releases: every byte, the structure, every frame, and a replay. See docs/verifying.md."""

from gym_open.artefacts import Problem
from gym_open.datasets.verify.report import Check, VerificationReport
from gym_open.datasets.verify.run import verify_release

__all__ = ["Check", "Problem", "VerificationReport", "verify_release"]
