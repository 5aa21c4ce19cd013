"""Set which bodies sleep.

MuJoCo stores sleep in `tree_asleep`, which is not part of its saved state, and in lists derived from it. A write to
`tree_asleep` does not update these lists. A world goes on bit for bit only if both are restored.
"""

import mujoco
import numpy as np

AWAKE = -(1 + mujoco.mjMINAWAKE)
"""MuJoCo's value for a body that has just moved. It counts up to −1, then the body may sleep."""


def set_asleep(model: mujoco.MjModel, data: mujoco.MjData, asleep: np.ndarray) -> None:
    """Put trees of bodies to sleep or wake them; `asleep` (ntree,) has MuJoCo's own values.

    The derived quantities of sleeping bodies must be up to date, because MuJoCo no longer updates them.
    """
    data.tree_asleep[:] = asleep
    data.tree_awake[:] = asleep < 0
    data.ntree_awake = int(data.tree_awake.sum())
    moving = model.body_treeid >= 0
    data.body_awake[moving] = data.tree_awake[model.body_treeid[moving]]
    bodies = np.flatnonzero(data.body_awake != mujoco.mjtSleepState.mjS_ASLEEP)
    data.nbody_awake = len(bodies)
    data.body_awake_ind[: len(bodies)] = bodies
    dofs = np.flatnonzero(data.tree_awake[model.dof_treeid])
    data.nv_awake = len(dofs)
    data.dof_awake_ind[: len(dofs)] = dofs
