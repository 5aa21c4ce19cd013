"""OpenGL for `mujoco.Renderer`: which library draws without a screen here, and what to install where none does."""

import ctypes
import os
import sys

import mujoco
from mujoco.rendering.classic import gl_context

from gym_open.errors import GymOpenError

_LIBRARIES = {"egl": ("libEGL.so.1", "libOpenGL.so.0"), "osmesa": ("libOSMesa.so.8",)}
_INSTALL = "on Debian and Ubuntu: apt-get install libegl1 libopengl0 libgl1-mesa-dri"


class OpenGLError(GymOpenError):
    """There is no OpenGL to draw with."""


def find_backend() -> str | None:
    """The value of MUJOCO_GL that draws without a screen here: what is set already, else what can be loaded."""
    if backend := os.environ.get("MUJOCO_GL"):
        return backend
    for backend, libraries in _LIBRARIES.items():
        try:
            for library in libraries:
                ctypes.CDLL(library)
        except OSError:
            continue
        return backend
    return None


def open_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """A renderer of pictures of this size, to be used and closed on the thread that opened it.

    MuJoCo chooses its OpenGL as it is imported, and dies of a library that is missing; so this chooses for it, later.

    Raises:
        OpenGLError: if there is no OpenGL here; says what to install.
    """
    try:
        if sys.platform == "linux":
            gl_context.GLContext = _linux_context()
        return mujoco.Renderer(model, height, width)
    except OpenGLError:
        raise
    except Exception as error:  # each library fails in its own way
        raise OpenGLError(f"OpenGL gives no picture of {width}×{height}: {error}; {_INSTALL}") from error


def _linux_context() -> type:
    backend = find_backend()
    if backend is None:
        raise OpenGLError(f"no OpenGL library was found, which this picture needs; {_INSTALL}")
    if backend == "egl":
        from mujoco.egl import GLContext
    elif backend == "osmesa":
        from mujoco.osmesa import GLContext
    else:
        return gl_context.GLContext
    return GLContext
