"""Contacts during a step."""

import msgspec
import mujoco
import numpy as np

GROUND = -1


class Contact(msgspec.Struct, frozen=True):
    """A contact between two things during a step."""

    a: str
    b: str
    """Names of inventory objects, or of pieces of scenery such as `wall_east`."""
    position: tuple[float, float, float]
    """Mean position in metres over the step, weighted by impulse."""
    normal: tuple[float, float, float]
    """Unit vector from a to b."""
    impulse: float
    """N s along the normal, summed over the step."""


def things_of(model: mujoco.MjModel) -> np.ndarray:
    """(ngeom,) int32: for each geom, the id of the thing that it belongs to; `GROUND` for the ground.

    A moving body is one thing, with its first geom's id. Every other geom is a thing of its own.
    """
    things = np.arange(model.ngeom, dtype=np.int32)
    moving = np.isin(model.geom_bodyid, model.jnt_bodyid)
    things[moving] = model.body_geomadr[model.geom_bodyid[moving]]
    things[model.geom("ground").id] = GROUND
    return things


def thing_names(model: mujoco.MjModel) -> list[str]:
    """Name in contacts of each geom's thing, (ngeom)."""
    moving = set(model.jnt_bodyid.tolist())
    return [
        model.body(body).name if body in moving else model.geom(geom).name
        for geom, body in enumerate(model.geom_bodyid.tolist())
    ]


def contacts_of(names: list[str], pairs: np.ndarray, sums: np.ndarray) -> tuple[Contact, ...]:
    """Build contacts from pairs of things (n, 2) and their impulses, positions and normals (n, 7 or more)."""
    return tuple(
        Contact(names[a], names[b], (row[1], row[2], row[3]), (row[4], row[5], row[6]), row[0])
        for (a, b), row in zip(pairs.tolist(), sums.tolist(), strict=True)
    )
