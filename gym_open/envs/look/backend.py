"""Find an OpenGL backend that draws without a screen. MuJoCo is not imported: a wrong MUJOCO_GL breaks its import."""

import ctypes
import os
import sys

from gym_open.errors import GymOpenError

_LIBRARIES = {"egl": ("libEGL.so.1", "libOpenGL.so.0"), "osmesa": ("libOSMesa.so.8",)}
_OTHERS = ("glfw", "glx", "enable", "enabled", "on", "true", "1", "disable", "disabled", "off", "false", "0", "")
"""Other values that MuJoCo accepts."""
INSTALL = "on Debian and Ubuntu: apt-get install libegl1 libopengl0 libgl1-mesa-dri"
"""Remedy if there is no OpenGL."""


class OpenGLError(GymOpenError):
    """No OpenGL is available."""


def find_backend() -> str | None:
    """The value of MUJOCO_GL to draw without a screen: the present value, else the first backend that can be loaded."""
    return os.environ.get("MUJOCO_GL") or next((name for name in _LIBRARIES if _loads(name)), None)


def check_backend() -> None:
    """Check MUJOCO_GL. Call this before MuJoCo is imported: the import needs that library even if nothing is drawn.

    Raises:
        OpenGLError: if the library is missing or unknown; gives the remedy.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if sys.platform != "linux":
        return
    if asked not in (*_LIBRARIES, *_OTHERS):
        raise OpenGLError(f"the environment variable MUJOCO_GL is {asked!r}, which MuJoCo does not know: unset it")
    if asked in _LIBRARIES and not _loads(asked):
        raise OpenGLError(
            f"the environment variable MUJOCO_GL asks for {asked!r}, but its library is not installed "
            f"({', '.join(_LIBRARIES[asked])}), and MuJoCo needs it to start: unset MUJOCO_GL; to draw, {INSTALL}"
        )


def _loads(backend: str) -> bool:
    try:
        for library in _LIBRARIES[backend]:
            ctypes.CDLL(library)
    except OSError:
        return False
    return True
