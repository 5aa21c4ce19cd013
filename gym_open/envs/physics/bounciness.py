"""Contact settings that result in a given bounciness.

MuJoCo's contact is a spring with a damper that pushes and never pulls. The share of the closing speed that is left
depends on the damping ratio, on the timestep, and on the phase between two substeps at which the contact begins. The
settings are chosen so that the mean over all phases is the requested bounciness.
"""

import functools

import numpy as np

_STIFFNESS = 40_000.0
"""1/s². With a much stiffer spring, a contact that begins late in a substep would add speed."""
_MOST_BRAKE = 200.0
"""1/s, for the same reason. A bounciness that needs a stronger damper gets a softer spring instead."""
_PHASES = (np.arange(32) + 0.5) / 32


def contact_reference(bounciness: float, timestep_s: float) -> str:
    """MuJoCo's `solref` of contacts that leave this fraction of the closing speed, as the mean over phases."""
    stiffness, brake = _settings(_damping_ratio(bounciness, timestep_s))
    return f"{-stiffness:.6g} {-brake:.4g}"


@functools.cache
def _damping_ratio(bounciness: float, timestep_s: float) -> float:
    low, high = 0.0, 3.0
    for _ in range(40):
        ratio = (low + high) / 2
        bounces_more = restitution(*_settings(ratio), timestep_s).mean() > bounciness
        low, high = (ratio, high) if bounces_more else (low, ratio)
    return low


def _settings(damping_ratio: float) -> tuple[float, float]:
    brake = min(2 * damping_ratio * _STIFFNESS**0.5, _MOST_BRAKE)
    return (brake / (2 * damping_ratio)) ** 2, brake


def restitution(stiffness: float, brake: float, timestep_s: float) -> np.ndarray:
    """(32,) ratio of separating to closing speed, for each phase within a substep at which the contact begins.

    Args:
        stiffness: acceleration per depth, 1/s².
        brake: acceleration per speed, 1/s.
        timestep_s: timestep of the integration, which advances first speed, then depth.
    """
    speed = np.ones_like(_PHASES)
    depth = _PHASES * timestep_s
    left = np.zeros_like(_PHASES)
    touching = depth > 0
    for _ in range(round(1 / timestep_s)):
        speed = speed - np.maximum(stiffness * depth + brake * speed, 0) * timestep_s
        depth = depth + speed * timestep_s
        apart = touching & (depth <= 0)
        left[apart] = -speed[apart]
        touching &= ~apart
        if not touching.any():
            break
    return left
