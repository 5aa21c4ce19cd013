"""The MCAP container: every byte of a file is checked before anything in it is believed.

The `mcap` package reads past damage unless told otherwise and never looks at the summary's CRC; here the walk over the
records is our own, so that an error can say at which byte the damage is and how much before it is whole.
"""

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message, Metadata
from mcap.writer import MCAP0_MAGIC

MAX_CHUNK = 64 * 2**20
"""Bytes that one chunk may unpack to; ours are of 4 MiB."""
MAX_EXPANSION = 1000
"""How many times its size a file may unpack to. Its index takes 50 bytes a step of 23 kB, so ours stay under 500."""

_HEAD = struct.Struct("<BQ")


class Damage(Exception):  # noqa: N818 - it becomes a LogError, which names the file
    """Something is wrong at byte `offset` of a file."""

    def __init__(self, offset: int, what: str) -> None:
        super().__init__(what)
        self.offset, self.what = offset, what


class Logged(NamedTuple):
    """One message of a chunk."""

    topic: str
    time: int
    data: bytes


class Place(NamedTuple):
    """Where a chunk lies and how many messages of each channel number it holds."""

    offset: int
    counts: dict[int, int]


class Contents(NamedTuple):
    """What a whole file holds beside its messages."""

    chunks: list[Place]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]


class _Record(NamedTuple):
    offset: int
    opcode: int
    data: bytes


def _records(file: BinaryIO, size: int) -> Iterator[_Record]:
    """Records in order, the footer last. Raises `Damage` where the file stops making sense."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise Damage(0, "not an MCAP file (its first bytes are another format's)")
    offset, opcode = len(MCAP0_MAGIC), 0
    while opcode != Opcode.FOOTER:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise Damage(offset, "the file is cut off between two records")
        opcode, length = _HEAD.unpack(head)
        if length > size - offset - _HEAD.size:
            missing = length - (size - offset - _HEAD.size)
            raise Damage(offset, f"the file is cut off: the record that begins here lacks {missing} bytes")
        yield _Record(offset, opcode, file.read(length))
        offset += _HEAD.size + length
    if file.read() != MCAP0_MAGIC:
        raise Damage(offset, "the file does not end where its footer does")


def read_contents(path: Path) -> Contents:
    """Check the whole file at `path` (data CRC, summary CRC, sizes) and return what it holds beside its messages.

    Raises:
        Damage: at the first byte that cannot be right.
    """
    contents = Contents([], {}, {})
    size, unpacked = path.stat().st_size, 0
    check = _Checksums()
    with path.open("rb") as file:
        for record in _records(file, size):
            check.update(record)
            with _damage_at(record.offset):
                _note(record, contents)
                unpacked += _unpacked_size(record) if record.opcode == Opcode.CHUNK else 0
    check.finish()
    if unpacked > MAX_EXPANSION * size:
        raise Damage(0, f"it would unpack to {unpacked} bytes, more than {MAX_EXPANSION} times its size; refused")
    return contents


def _note(record: _Record, contents: Contents) -> None:
    stream = ReadDataStream(BytesIO(record.data))
    if record.opcode == Opcode.CHUNK:
        contents.chunks.append(Place(record.offset, {}))
    elif record.opcode == Opcode.MESSAGE_INDEX:
        channel, length = struct.unpack_from("<HI", record.data)
        contents.chunks[-1].counts[channel] = length // 16
    elif record.opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream)
        contents.attachments[attachment.name] = attachment.data
    elif record.opcode == Opcode.METADATA:
        entry = Metadata.read(stream)
        contents.metadata[entry.name] = entry.metadata


@contextmanager
def _damage_at(offset: int) -> Iterator[None]:
    """Whatever the parsers of a record raise over nonsense is damage of that record."""
    try:
        yield
    except (McapError, struct.error, ValueError, IndexError, OverflowError, zstandard.ZstdError) as error:
        raise Damage(offset, f"the record that begins here makes no sense ({error or type(error).__name__})") from None


class _Checksums:
    """CRC-32 of the data section up to DataEnd, then of the summary up to the footer's own CRC."""

    def __init__(self) -> None:
        self._crc = zlib.crc32(MCAP0_MAGIC)
        self._data_checked = False
        self._summary_checked = False

    def update(self, record: _Record) -> None:
        head = _HEAD.pack(record.opcode, len(record.data))
        if record.opcode == Opcode.DATA_END:
            self._compare(record.offset, record.data, "data section")
            self._crc, self._data_checked = 0, True
        elif record.opcode == Opcode.FOOTER:
            self._crc = zlib.crc32(record.data[:-4], zlib.crc32(head, self._crc))
            self._compare(record.offset, record.data[-4:], "summary")
            self._summary_checked = True
        else:
            self._crc = zlib.crc32(record.data, zlib.crc32(head, self._crc))

    def _compare(self, offset: int, stored: bytes, name: str) -> None:
        if int.from_bytes(stored, "little") != self._crc:
            raise Damage(offset, f"the CRC of the {name} before this byte is wrong: bytes were changed")

    def finish(self) -> None:
        if not (self._data_checked and self._summary_checked):
            raise Damage(0, "it has no checksums, so it cannot be trusted")


def _unpacked_size(record: _Record) -> int:
    unpacked = Chunk.read(ReadDataStream(BytesIO(record.data))).uncompressed_size
    if unpacked > MAX_CHUNK:
        raise Damage(record.offset, f"a chunk would unpack to {unpacked} bytes, the limit is {MAX_CHUNK}; refused")
    return unpacked


def read_chunk(path: Path, place: Place, topics: dict[int, str]) -> Iterator[Logged]:
    """Messages of one chunk in the order of writing; `topics` by channel number is added to as channels appear.

    Raises:
        Damage: if the chunk does not unpack to what it says.
    """
    with path.open("rb") as file:
        file.seek(place.offset)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        yield from _messages(_Record(place.offset, opcode, file.read(length)), topics)


def whole_chunks(path: Path, end: int | None = None) -> Iterator[list[Logged]]:
    """Messages of each whole chunk from the beginning of a file that may be cut off or damaged; never raises `Damage`.

    This is what can be saved of a log whose writer was killed. Chunks from byte `end` on are left alone.
    """
    topics: dict[int, str] = {}
    size = path.stat().st_size
    end = size if end is None else end
    with path.open("rb") as file:
        try:
            for record in _records(file, size):
                if record.offset >= end:
                    return
                if record.opcode == Opcode.CHUNK:
                    yield list(_messages(record, topics))
        except Damage:
            return


def _messages(record: _Record, topics: dict[int, str]) -> Iterator[Logged]:
    with _damage_at(record.offset):
        raw = _unpack(record)
        offset = 0
        while offset < len(raw):
            opcode, length = _HEAD.unpack_from(raw, offset)
            offset += _HEAD.size
            stream = ReadDataStream(BytesIO(raw[offset : offset + length]))
            if opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                topics[channel.id] = channel.topic
            elif opcode == Opcode.MESSAGE:
                message = Message.read(stream, length)
                yield Logged(topics.get(message.channel_id, ""), message.log_time, message.data)
            offset += length


def _unpack(record: _Record) -> bytes:
    """The bytes of a chunk, its size and CRC checked; the size is looked at before anything is unpacked."""
    _unpacked_size(record)
    chunk = Chunk.read(ReadDataStream(BytesIO(record.data)))
    if chunk.compression != "zstd" or zstandard.frame_content_size(chunk.data) != chunk.uncompressed_size:
        raise Damage(record.offset, "a chunk is not packed as it says")
    raw = zstandard.decompress(chunk.data)
    if zlib.crc32(raw) != chunk.uncompressed_crc:
        raise Damage(record.offset, "the CRC of a chunk is wrong: bytes were changed")
    return raw
