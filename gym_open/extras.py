"""Optional parts of gym-open: which packages each needs, and what to say where one is not installed.

`pip install gym-open` installs the world alone. `pip install 'gym-open[train]'` adds an *extra*; `pyproject.toml` lists
them, docs/installing.md says what each is for.
"""

from importlib.util import find_spec
from types import TracebackType

from gym_open.errors import MissingExtraError

MODULES = {
    "releases": (
        "PIL", "av", "huggingface_hub", "jinja2", "matplotlib", "mcap", "pandas", "pyarrow", "scipy", "tomli_w",
        "zstandard",
    ),
    "train": ("safetensors", "tensorboard", "torch"),
    "viz": ("rerun", "rerun_cli"),
    "play": ("pygame",),
    "remote": ("grpc",),
    "meshes": ("coacd", "trimesh"),
    "sign": ("model_signing", "OpenSSL"),
    "minari": ("minari",),
    "lerobot": ("lerobot",),
}  # fmt: skip
"""Modules that come with each extra."""
PARTS_OF = {"train": ("releases",), "viz": ("releases",), "play": ("releases",), "sign": ("releases",),
            "minari": ("releases",), "lerobot": ("releases",)}  # fmt: skip
"""Extras that an extra brings along."""


def check(*extras: str) -> None:
    """Find the packages of these extras, and of the extras that they bring along. Nothing is imported.

    Raises:
        MissingExtraError: naming the packages that are not installed, and the command that installs them.
    """
    every = {part for extra in extras for part in (extra, *PARTS_OF.get(extra, ()))}
    missing = sorted(name for extra in every for name in MODULES[extra] if find_spec(name) is None)
    if missing:
        raise _missing(missing, extras)


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
