"""Curves of any number of encoders and policies, of scores, probes and reports, and of a whole grid."""

from gym_open.viz.curves.assemble import view

__all__ = ["view"]
