"""Open a `mujoco.Renderer` on an OpenGL backend that draws without a screen."""

import importlib
import sys
from contextlib import suppress

import mujoco
from mujoco.rendering.classic import gl_context

from gym_open.envs.look.backend import INSTALL, OpenGLError, find_backend


def open_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """Open a renderer for images of this size. Use and close it on the thread that opened it.

    MuJoCo chooses its OpenGL when it is imported, and the import fails if that library is missing. So this function
    chooses later, and replaces MuJoCo's choice.

    Raises:
        OpenGLError: if there is no OpenGL; names the packages to install.
    """
    try:
        if sys.platform == "linux":
            _load_triton()
            gl_context.GLContext = _linux_context()
        return mujoco.Renderer(model, height, width)
    except OpenGLError:
        raise
    except Exception as error:  # each library raises other errors
        raise OpenGLError(f"OpenGL gives no image of {width}×{height}: {error}; {INSTALL}") from error


def _load_triton() -> None:
    """Load Triton, if it is installed, before OpenGL.

    PyTorch with CUDA imports Triton 3.9 when it makes its first optimizer. If Mesa's LLVM is loaded already, Triton
    calls functions of Mesa's LLVM instead of its own, and the process ends with a segmentation fault. In this order
    both work.
    """
    with suppress(ImportError):
        importlib.import_module("triton")


def _linux_context() -> type:
    backend = find_backend()
    if backend is None:
        raise OpenGLError(f"no OpenGL library was found, but this image needs it; {INSTALL}")
    if backend == "egl":
        from mujoco.egl import GLContext
    elif backend == "osmesa":
        from mujoco.osmesa import GLContext
    else:
        return gl_context.GLContext
    return GLContext
