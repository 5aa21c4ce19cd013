"""Where a film, picture or recording may be written."""

import os
from pathlib import Path

from gym_open import artefacts
from gym_open.errors import UsageError


def hidden_beside(out: Path) -> Path:
    """A hidden file beside `out` that no other process writes, to be renamed when it is whole."""
    return out.with_name(f".{out.name}.{os.getpid()}.tmp")


def refuse_artefact(out: Path) -> None:
    """Refuse to write into a finished artefact, since that would no longer be what its manifest says.

    Raises:
        UsageError: if `out` lies in one.
    """
    for folder in out.resolve().parents:
        finished = not folder.name.startswith(".")  # a hidden one is still being made, perhaps with this file in it
        if finished and all((folder / name).is_file() for name in (artefacts.MANIFEST, artefacts.LINEAGE)):
            raise UsageError(f"{out}: in the artefact {folder}, whose files are fixed; give a place elsewhere")
