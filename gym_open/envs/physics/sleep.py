"""Setting which bodies sleep.

MuJoCo keeps sleep in `tree_asleep`, which is no part of its saved state, and in lists that it derives from it but does
not derive anew when `tree_asleep` is written. Both must be restored for a world to go on bit for bit.
"""

import mujoco
import numpy as np

AWAKE = -(1 + mujoco.mjMINAWAKE)
"""What MuJoCo notes for a body that was just moved; it counts up to −1, then the body may sleep."""


def set_asleep(model: mujoco.MjModel, data: mujoco.MjData, asleep: np.ndarray) -> None:
    """Put trees of bodies to sleep, or wake them, as `asleep` (ntree,) says in MuJoCo's own code.

    Every derived quantity of the sleepers must be up to date, since MuJoCo leaves it alone from now on.
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
