"""Tables of what log files hold and whether they are damaged, for people."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from rich.table import Table

from gym_open import progress
from gym_open.formats.logs import schemas
from gym_open.formats.logs.container import Damage
from gym_open.formats.logs.folder import NamedHead, folder_faults
from gym_open.formats.logs.logfile import foreign, open_whole_chunks
from gym_open.formats.logs.messages import decode_segment, decode_stuck, decode_switch
from gym_open.formats.logs.reader import found_files
from gym_open.formats.logs.schemas import LogHead, Stuck, Switch
from gym_open.terminal import markup, titled_table

_NO_IMAGE = np.empty(0)


class FileInfo(msgspec.Struct):
    """What one file holds; in a damaged file, before the damage."""

    path: Path
    bytes: int
    head: LogHead
    part: int
    goes_on: bool = False
    damage: Damage | None = None
    messages: Counter[str] = msgspec.field(default_factory=Counter)
    """Number of messages by topic."""
    first_world: int | None = None
    """The world in which the file begins."""
    switches: list[Switch] = []
    stuck: list[Stuck] = []

    @property
    def steps(self) -> int:
        """Number of actions."""
        return self.messages[schemas.STEP]

    @property
    def seconds(self) -> float:
        """Simulated time (s)."""
        return self.steps * schemas.STEP_NS / 1e9

    @property
    def health(self) -> str:
        """Whether the file is whole, and at which byte it is damaged."""
        if self.damage is not None:
            return f"at byte {self.damage.offset:,}: {self.damage.what}"
        if not (self.goes_on or (self.switches and self.switches[-1].to_world < 0)):
            return "not ended: no last switch in it"
        return "whole, goes on" if self.goes_on else "whole"


def inspect(path: Path) -> FileInfo:
    """Read the head of the log file at `path` and count its messages, up to the first damage.

    Raises:
        LogError: if the file is missing, not a log, or damaged in its head.
    """
    file, damage = open_whole_chunks(path)
    info = FileInfo(path, path.stat().st_size, file.head, file.part, file.goes_on, damage)
    info.messages.update({topic: file.count(topic) for topic in schemas.DEFINITIONS})
    try:
        for message in file.messages(schemas.SEGMENT, schemas.SWITCH, schemas.STUCK):
            if message.topic == schemas.SWITCH:
                info.switches.append(decode_switch(message.data))
            elif message.topic == schemas.STUCK:
                info.stuck.append(decode_stuck(message.data))
            elif info.first_world is None:
                info.first_world = decode_segment(message.data, file.head.puzzles, _NO_IMAGE).world
    except ValueError as error:
        raise foreign(path, error) from None
    return info


def info_tables(source: Path) -> tuple[list[Table], list[str]]:
    """Tables of the files, streams and channels of a log file or of a folder with logs, and what is wrong.

    Raises:
        ArtefactError: if there is no log, or a file is not a log.
    """
    paths = [source]
    if not source.is_file():
        paths = [path for parts in found_files(source).values() for path in parts.values()]
    with progress.bar("log info", len(paths)) as bar:
        files: list[FileInfo] = []
        for path in paths:
            files.append(inspect(path))
            bar.advance()
    wrong = [f"{file.path}: damaged {file.health}" for file in files if file.damage is not None]
    if not source.is_file():
        wrong += folder_faults(source, [NamedHead(file.path, file.head, file.part) for file in files])
    return [_files(files), _streams(files, alone=source.is_file()), _channels(files)], wrong


def _files(files: Sequence[FileInfo]) -> Table:
    head = files[0].head
    seed = f", seed {head.provenance['seed']}" if "seed" in head.provenance else ""
    title = f"{schemas.FORMAT}, written by {head.provenance.get('code', 'an unknown version')}{seed}"
    numbers = ["steps", "simulated", "bytes", "B/step"]
    table = titled_table(title, ["file", *numbers, "health"], right=numbers, unbroken=["file"])
    for file in files:
        table.add_row(markup(file.path.name), *_size([file]), markup(file.health))
    return table


def _size(files: Sequence[FileInfo]) -> tuple[str, str, str, str]:
    steps, size = sum(file.steps for file in files), sum(file.bytes for file in files)
    each = f"{size / steps:,.0f}" if steps else "–"
    return f"{steps:,}", f"{sum(file.seconds for file in files):,.0f} s", f"{size:,}", each


def _streams(files: Sequence[FileInfo], *, alone: bool) -> Table:
    numbers = ["steps", "B/step", "worlds", "segments", "stuck"]
    table = titled_table("streams", ["stream", *numbers, "switches", "health"], right=numbers)
    for stream in sorted({file.head.stream for file in files}):
        own = [file for file in files if file.head.stream == stream]
        switches = [switch for file in own for switch in file.switches]
        worlds = {own[0].first_world, *(switch.to_world for switch in switches)} - {None, -1}
        entered = sum(switch.to_world >= 0 for switch in switches)
        reasons = Counter(switch.reason for switch in switches)
        steps, _, _, each = _size(own)
        table.add_row(
            str(stream), steps, each, f"{len(worlds)} of {len(own[0].head.puzzles)}", str(entered),
            str(sum(stuck.began for file in own for stuck in file.stuck)),
            ", ".join(f"{reason} {count}" for reason, count in reasons.items()),
            markup(_health(own, alone=alone)),
        )  # fmt: skip
    return table


def _health(files: Sequence[FileInfo], *, alone: bool) -> str:
    """Health of all files of a stream; a file that was given `alone` does not need the other parts."""
    if damaged := [str(file.part) for file in files if file.damage is not None]:
        return f"part {', '.join(damaged)} damaged"
    if alone:
        return files[0].health
    there = {file.part for file in files}
    if missing := sorted(set(range(max(there) + 1 + files[-1].goes_on)) - there):
        return f"part {', '.join(map(str, missing))} missing"
    return files[-1].health


def _channels(files: Sequence[FileInfo]) -> Table:
    table = titled_table("channels", ["topic", "type", "messages"], right=["messages"])
    total = sum((file.messages for file in files), Counter[str]())
    for topic, (kind, _) in schemas.DEFINITIONS.items():
        if total[topic]:
            table.add_row(topic, kind, f"{total[topic]:,}")
    return table
