"""A `mujoco.Renderer` on whatever OpenGL draws without a screen here."""

import importlib
import sys
from contextlib import suppress

import mujoco
from mujoco.rendering.classic import gl_context

from gym_open.envs.look.backend import INSTALL, OpenGLError, find_backend


def open_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """A renderer of pictures of this size, to be used and closed on the thread that opened it.

    MuJoCo chooses its OpenGL as it is imported, and dies of a library that is missing; so this chooses for it, later.

    Raises:
        OpenGLError: if there is no OpenGL here; says what to install.
    """
    try:
        if sys.platform == "linux":
            _load_triton()
            gl_context.GLContext = _linux_context()
        return mujoco.Renderer(model, height, width)
    except OpenGLError:
        raise
    except Exception as error:  # each library fails in its own way
        raise OpenGLError(f"OpenGL gives no picture of {width}×{height}: {error}; {INSTALL}") from error


def _load_triton() -> None:
    """Load Triton, if it is installed, before OpenGL.

    PyTorch with CUDA imports Triton 3.9 with its first optimizer. Where Mesa's LLVM is loaded already, Triton takes
    functions of that for its own, and the process ends with a segmentation fault. In this order both work.
    """
    with suppress(ImportError):
        importlib.import_module("triton")


def _linux_context() -> type:
    backend = find_backend()
    if backend is None:
        raise OpenGLError(f"no OpenGL library was found, which this picture needs; {INSTALL}")
    if backend == "egl":
        from mujoco.egl import GLContext
    elif backend == "osmesa":
        from mujoco.osmesa import GLContext
    else:
        return gl_context.GLContext
    return GLContext
