"""What touched what during a step, summed over its substeps."""

import msgspec
import mujoco
import numpy as np

from gym_open.envs.jit import compiled

_ROOM = 256
"""Pairs of geoms that can touch in one step: far more than 27 objects on a table do."""


class Contact(msgspec.Struct, frozen=True):
    """Two things that touched during a step."""

    a: str
    b: str
    """Names of inventory objects, or of pieces of scenery such as `wall_east`."""
    position: tuple[float, float, float]
    """Where, in metres: the mean over the step, weighted by impulse."""
    normal: tuple[float, float, float]
    """Unit vector from a to b."""
    impulse: float
    """N s along the normal, summed over the step."""


@compiled
def _gather(  # noqa: PLR0917  # numba takes arrays, not objects
    geoms: np.ndarray,
    frames: np.ndarray,
    positions: np.ndarray,
    addresses: np.ndarray,
    forces: np.ndarray,
    timestep: float,
    ignored: np.ndarray,
    pairs: np.ndarray,
    sums: np.ndarray,
    count: int,
) -> int:
    """Add one substep's contacts to the pairs (n, 2) and sums (n, 7: impulse, position and normal times weight)."""
    for i in range(geoms.shape[0]):
        a, b = geoms[i, 0], geoms[i, 1]
        if ignored[a] or ignored[b]:
            continue
        slot = 0
        while slot < count and (pairs[slot, 0] != a or pairs[slot, 1] != b):
            slot += 1
        if slot == pairs.shape[0]:
            continue
        if slot == count:
            pairs[slot, 0], pairs[slot, 1] = a, b
            sums[slot] = 0.0
            count += 1
        impulse = forces[addresses[i]] * timestep if addresses[i] >= 0 else 0.0
        weight = impulse + 1e-12
        sums[slot, 0] += impulse
        for k in range(3):
            sums[slot, 1 + k] += weight * positions[i, k]
            sums[slot, 4 + k] += weight * frames[i, k]
        sums[slot, 7] += weight
    return count


class ContactSum:
    """Contacts of one step while they are being summed; contacts with the ground are left out."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._names = [model.geom(i).name for i in range(model.ngeom)]
        self._timestep = model.opt.timestep
        self._ignored = np.array([name == "ground" for name in self._names])
        self._pairs = np.zeros((_ROOM, 2), np.int32)
        self._sums = np.zeros((_ROOM, 8))
        self.count = 0

    @property
    def pairs(self) -> np.ndarray:
        """Geom ids (n, 2) of what touched so far."""
        return self._pairs[: self.count]

    def clear(self) -> None:
        """Begin a step."""
        self.count = 0

    def add(self, data: mujoco.MjData) -> None:
        """Add the contacts of the substep that was just taken."""
        if data.ncon:
            contact = data.contact
            self.count = _gather(
                contact.geom,
                contact.frame,
                contact.pos,
                contact.efc_address,
                data.efc_force,
                self._timestep,
                self._ignored,
                self._pairs,
                self._sums,
                self.count,
            )

    def contacts(self) -> tuple[Contact, ...]:
        """The step's contacts, in the order in which they began."""
        return tuple(self._contact(slot) for slot in range(self.count))

    def _contact(self, slot: int) -> Contact:
        a, b = self._pairs[slot]
        impulse, *sums, weight = self._sums[slot].tolist()
        position, normal = np.array(sums[:3]) / weight, np.array(sums[3:])
        normal /= np.linalg.norm(normal) or 1.0
        return Contact(self._names[a], self._names[b], tuple(position.tolist()), tuple(normal.tolist()), impulse)
