"""Which OpenGL draws without a screen here. MuJoCo is not imported: it dies of MUJOCO_GL naming one that is missing."""

import ctypes
import os
import sys

from gym_open.errors import GymOpenError

_LIBRARIES = {"egl": ("libEGL.so.1", "libOpenGL.so.0"), "osmesa": ("libOSMesa.so.8",)}
_OTHERS = ("glfw", "glx", "enable", "enabled", "on", "true", "1", "disable", "disabled", "off", "false", "0", "")
"""What else MuJoCo takes."""
INSTALL = "on Debian and Ubuntu: apt-get install libegl1 libopengl0 libgl1-mesa-dri"
"""What to do where there is none."""


class OpenGLError(GymOpenError):
    """There is no OpenGL to draw with."""


def find_backend() -> str | None:
    """The value of MUJOCO_GL that draws without a screen here: what is set already, else what can be loaded."""
    return os.environ.get("MUJOCO_GL") or next((name for name in _LIBRARIES if _loads(name)), None)


def check_backend() -> None:
    """To be called before MuJoCo is imported, which needs what MUJOCO_GL names even where nothing is drawn.

    Raises:
        OpenGLError: if that is missing or unknown; says what to do.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if sys.platform != "linux":
        return
    if asked not in (*_LIBRARIES, *_OTHERS):
        raise OpenGLError(f"the environment variable MUJOCO_GL is {asked!r}, which MuJoCo does not know: unset it")
    if asked in _LIBRARIES and not _loads(asked):
        raise OpenGLError(
            f"the environment variable MUJOCO_GL asks for {asked!r}, whose library is not here "
            f"({', '.join(_LIBRARIES[asked])}), and MuJoCo does not start so: unset MUJOCO_GL; to draw, {INSTALL}"
        )


def _loads(backend: str) -> bool:
    try:
        for library in _LIBRARIES[backend]:
            ctypes.CDLL(library)
    except OSError:
        return False
    return True
