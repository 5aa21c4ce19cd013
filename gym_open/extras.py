"""Optional parts of gym-open: the packages that each part needs, and the error if one is not installed.

`pip install gym-open` installs only the world. `pip install 'gym-open[train]'` adds an *extra*. `pyproject.toml` lists
the extras, and docs/installing.md explains the purpose of each.
"""

from importlib.util import find_spec
from types import TracebackType

from gym_open.errors import MissingExtraError

MODULES = {
    "releases": ("PIL", "huggingface_hub", "jinja2", "mcap", "pandas", "pyarrow", "tomli_w", "zstandard"),
    "build": ("av", "matplotlib", "scipy"),
    "train": ("safetensors", "tensorboard", "torch"),
    "viz": ("rerun", "rerun_cli"),
    "play": ("pygame",),
    "remote": ("grpc",),
    "meshes": ("coacd", "trimesh"),
    "sign": ("model_signing", "OpenSSL"),
    "minari": ("minari",),
    "lerobot": ("lerobot",),
}
"""Modules that each extra installs."""
RESTS_ON = {
    "build": "releases",
    "train": "build",
    "viz": "build",
    "play": "releases",
    "sign": "releases",
    "minari": "releases",
    "lerobot": "releases",
}
"""The other extra that an extra includes."""


def check(*extras: str) -> None:
    """Check that the packages of these extras, and of the extras that they include, are installed. Import nothing.

    Raises:
        MissingExtraError: if packages are not installed; names them, and the command that installs them.
    """
    missing = sorted(name for extra in _closed(extras) for name in MODULES[extra] if find_spec(name) is None)
    if missing:
        raise _missing(missing, extras)


def _closed(extras: tuple[str, ...]) -> set[str]:
    """These extras, and all extras that they include."""
    below = tuple(RESTS_ON[extra] for extra in extras if extra in RESTS_ON)
    return {*extras, *_closed(below)} if below else set(extras)


class Named:
    """Context manager: an import that fails because an extra is not installed names the extra.

    Raises:
        MissingExtraError: instead of `ModuleNotFoundError`, if an extra installs the module.
    """

    def __enter__(self) -> None:
        """Nothing to do."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Replace the error if an extra installs the missing module."""
        if not isinstance(error, ModuleNotFoundError) or isinstance(error, MissingExtraError):
            return
        name = (error.name or "").partition(".")[0]
        extra = next((extra for extra, modules in MODULES.items() if name in modules), None)
        if extra:
            raise _missing([name], [extra]) from None


def _missing(modules: list[str], extras: "tuple[str, ...] | list[str]") -> MissingExtraError:
    are = "is" if len(modules) == 1 else "are"
    return MissingExtraError(
        f"{', '.join(modules)} {are} not installed: pip install 'gym-open[{','.join(extras)}]'", name=modules[0]
    )
