"""Check that the files in the folder of a log belong together: no stream is missing, renamed or of another run."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from gym_open import artefacts
from gym_open.formats.logs.schemas import LogHead, log_name


class NamedHead(NamedTuple):
    """The head of a log file, and where it is."""

    path: Path
    head: LogHead
    part: int


def folder_faults(folder: Path, files: Sequence[NamedHead]) -> Iterator[str]:
    """Find the faults of a folder with the log of a run, each as a sentence that names the file.

    Args:
        folder: the folder; of a finished log, its manifest counts, too.
        files: all log files in it.

    Raises:
        ArtefactError: if the manifest cannot be read.
    """
    first = files[0]
    for file in files:
        own = log_name(file.head.stream, file.part)
        if file.path.name != own:
            yield f"{file.path}: holds part {file.part} of stream {file.head.stream}, so its name must be {own}"
        for field in ("config", "puzzles", "provenance", "model_xml", "reward_parts"):
            if getattr(file.head, field) != getattr(first.head, field):
                yield f"{file.path}: its {field} differs from that of {first.path.name}: it is of another run"
    streams = first.head.config.get("streams")
    there = {file.head.stream for file in files}
    if isinstance(streams, int) and streams <= 10_000 and there != set(range(streams)):
        lacking = sorted(set(range(streams)) - there)
        what = f"stream {lacking[0]} is missing" if lacking else f"stream {max(there)} is too many"
        yield f"{folder}: {what}: its run had {streams} streams"
    if (folder / artefacts.MANIFEST).is_file():
        for problem in artefacts.problems(folder):
            yield f"{folder / problem.file}: {problem.what}"
