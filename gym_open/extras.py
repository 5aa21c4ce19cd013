"""Optional parts of gym-open: which packages each needs, and what to say where one is not installed.

`pip install gym-open` installs the world alone. `pip install 'gym-open[train]'` adds an *extra*; `pyproject.toml` lists
them, docs/installing.md says what each is for.
"""

from importlib.util import find_spec
from types import TracebackType

from gym_open.errors import MissingExtraError

MODULES = {
    "releases": ("PIL", "huggingface_hub", "mcap", "pandas", "pyarrow", "tomli_w", "zstandard"),
    "build": ("av", "jinja2", "matplotlib", "scipy"),
    "train": ("safetensors", "tensorboard", "torch"),
    "viz": ("rerun", "rerun_cli"),
    "play": ("pygame",),
    "remote": ("grpc",),
    "meshes": ("coacd", "trimesh"),
    "sign": ("model_signing", "OpenSSL"),
    "minari": ("minari",),
    "lerobot": ("lerobot",),
}
"""Modules that come with each extra."""
RESTS_ON = {
    "build": "releases",
    "train": "build",
    "viz": "build",
    "play": "releases",
    "sign": "releases",
    "minari": "releases",
    "lerobot": "releases",
}
"""The extra that an extra brings along."""


def check(*extras: str) -> None:
    """Find the packages of these extras, and of the extras that they bring along. Nothing is imported.

    Raises:
        MissingExtraError: naming the packages that are not installed, and the command that installs them.
    """
    missing = sorted(name for extra in _closed(extras) for name in MODULES[extra] if find_spec(name) is None)
    if missing:
        raise _missing(missing, extras)


def _closed(extras: tuple[str, ...]) -> set[str]:
    """These extras, and all that they bring along."""
    below = tuple(RESTS_ON[extra] for extra in extras if extra in RESTS_ON)
    return {*extras, *_closed(below)} if below else set(extras)


class Named:
    """`with Named():` an import that fails for want of an extra says which.

    Raises:
        MissingExtraError: in place of `ModuleNotFoundError`, if an extra has the module.
    """

    def __enter__(self) -> None:
        """Nothing to do."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Look at what was raised."""
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
