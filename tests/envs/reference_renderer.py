"""Run by test_parity.py in a process of its own: what mujoco.Renderer makes of some worlds.

Usage: reference_renderer.py STATES.npz PICTURES.npz; MUJOCO_GL is set by the caller.
Exit code 3 with a message means that there is no OpenGL context to be had here.
"""

import sys

import mujoco
import numpy as np

from gym_open.envs.constants import IMAGE_SIZE
from gym_open.envs.model import fixed_model


def main(states_file: str, pictures_file: str) -> None:
    model = fixed_model()
    data = mujoco.MjData(model)
    try:
        renderer = mujoco.Renderer(model, IMAGE_SIZE, IMAGE_SIZE)
    except Exception as error:
        print(f"{type(error).__name__}: {error}")
        raise SystemExit(3) from error
    for flag in ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE"):
        renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
    states = np.load(states_file)
    images, labels = [], []
    for qpos, mocap_pos, mocap_quat in zip(states["qpos"], states["mocap_pos"], states["mocap_quat"], strict=True):
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = qpos, mocap_pos, mocap_quat
        mujoco.mj_kinematics(model, data)
        renderer.update_scene(data, camera="observation")
        images.append(renderer.render().copy())
        renderer.enable_segmentation_rendering()
        labels.append(renderer.render()[..., 0].copy())
        renderer.disable_segmentation_rendering()
    renderer.close()
    np.savez(pictures_file, images=np.array(images), labels=np.array(labels))


if __name__ == "__main__":
    main(*sys.argv[1:])
