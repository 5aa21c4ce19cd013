"""A workspace: a folder that holds the five stage folders, such as the repository root. `gym-open init` makes one."""

import shutil
from pathlib import Path

from gym_open.errors import UsageError

STAGES = ("collect", "datasets", "train", "evaluate", "viz")

IGNORED = (
    "collect/logs/",
    "datasets/open/",
    "train/encoders/",
    "train/policies/",
    "train/probes/",
    "evaluate/scores/",
    "evaluate/reports/",
    "evaluate/benchmarks/",
    "viz/recordings/",
    "viz/figures/",
)
"""Folders that the stages write to by default."""


def template() -> Path:
    """The folder whose stage folders are copied: inside the installed wheel, or the repository root."""
    package = Path(__file__).parent
    packaged = package / "_workspace"
    return packaged if packaged.is_dir() else package.parent


def init(target: Path) -> list[Path]:
    """Make a workspace with the default configurations at `target`, and return the files written.

    Raises:
        UsageError: if a stage folder exists already; nothing is written then.
    """
    if taken := [stage for stage in STAGES if (target / stage).exists()]:
        raise UsageError(
            f"{target / taken[0]}: exists already; give `gym-open init` a folder without the stage folders"
        )
    written = []
    for stage in STAGES:
        (target / stage).mkdir(parents=True)
        source = template() / stage
        items = sorted([*source.glob("*.toml"), *source.glob("README.md")])
        written.extend(Path(shutil.copyfile(item, target / stage / item.name)) for item in items)
    ignore = target / ".gitignore"
    if not ignore.exists():
        ignore.write_text("".join(f"/{name}\n" for name in IGNORED) + ".*.partial*/\n.*.lock\n", encoding="utf-8")
        written.append(ignore)
    return written


def check(root: Path) -> Path:
    """Return `root` if it is a workspace.

    Raises:
        UsageError: if a stage folder is missing; names it, and the command that makes a workspace.
    """
    missing = next((stage for stage in STAGES if not (root / stage).is_dir()), None)
    if missing is not None:
        raise UsageError(f"{root}: not a workspace, it has no folder {missing!r}; make one with: gym-open init {root}")
    return root
