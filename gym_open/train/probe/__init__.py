"""Linear probes: what a linear map can read from a frozen encoder about new worlds."""

from gym_open.train.probe.probing import probe

__all__ = ["probe"]
