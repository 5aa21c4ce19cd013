"""Reader of the MCAP container: it checks every byte of a file before other modules use its contents.

The `mcap` package reads past damage by default and never checks the summary's CRC. This module walks over the records
itself, so that an error can name the byte of the damage and say how much before it is undamaged.
"""

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

MAX_CHUNK = 64 * 2**20
"""Greatest size in bytes of an unpacked chunk and of any record; our chunks have 4 MiB."""
MAX_EXPANSION = 2000
"""Greatest ratio of unpacked to packed size. The index takes 16 bytes per message, so our files stay below 1000."""

_IN_CHUNKS = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}
_LEAST_BYTES, _MOST_RECORDS = 64, 100
"""A chunk has at most this many records, and one more for each of so many bytes: reading a file of tiny records would
take minutes."""

T = TypeVar("T")

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence number, log time, publish time; the message's bytes follow."""
_UNPACKED = struct.Struct("<QQQ")
"""First fields of a chunk: first time, last time, unpacked size."""


class Damage(Exception):  # noqa: N818 - callers turn it into a LogError that names the file
    """Something is wrong at byte `offset` of a file."""

    def __init__(self, offset: int, what: str) -> None:
        super().__init__(what)
        self.offset, self.what = offset, what


class LogMessage(NamedTuple):
    """One message of a chunk."""

    topic: str
    time: int
    data: bytes


class ChunkPlace(NamedTuple):
    """A chunk's offset, the time of its first message, and its number of messages per channel number."""

    offset: int
    time: int
    counts: dict[int, int]


class Contents(NamedTuple):
    """What a file holds in addition to its messages."""

    chunks: list[ChunkPlace]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    schemas: dict[int, tuple[str, str]]
    """Message type and definition by schema number; from the summary at the file's end, like `channels`."""
    channels: dict[int, tuple[str, int]]
    """Topic and schema number by channel number."""

    @property
    def topics(self) -> dict[int, str]:
        """Topic by channel number."""
        return {number: topic for number, (topic, _) in self.channels.items()}


class _Record(NamedTuple):
    offset: int
    opcode: int
    data: bytes


def _records(file: BinaryIO, size: int) -> Iterator[_Record]:
    """Records in order, up to the footer. Raises `Damage` where a record is invalid or the unpacked size too large."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise Damage(0, "not an MCAP file (its first bytes are those of another format)")
    offset, opcode, unpacked = len(MCAP0_MAGIC), 0, 0
    while opcode != Opcode.FOOTER:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise Damage(offset, "the file is cut off between two records")
        opcode, length = _HEAD.unpack(head)
        if length > size - offset - _HEAD.size:
            missing = length - (size - offset - _HEAD.size)
            raise Damage(offset, f"the file is cut off: the record that begins here lacks {missing} bytes")
        if length > MAX_CHUNK:
            raise Damage(offset, f"a record has {length} bytes, the limit is {MAX_CHUNK}; refused")
        record = _Record(offset, opcode, file.read(length))
        unpacked += _unpacked_size(record) if opcode == Opcode.CHUNK else 0
        if unpacked > MAX_EXPANSION * size:
            raise Damage(0, f"the file would unpack to more than {MAX_EXPANSION} times its size; refused")
        yield record
        offset += _HEAD.size + length
    if file.read() != MCAP0_MAGIC:
        raise Damage(offset, "the file goes on after its footer")


def _unpacked_size(record: _Record) -> int:
    with _damage_at(record.offset):
        unpacked = _UNPACKED.unpack_from(record.data)[2]
    if unpacked > MAX_CHUNK:
        raise Damage(record.offset, f"a chunk would unpack to {unpacked} bytes, the limit is {MAX_CHUNK}; refused")
    return unpacked


def scan(path: Path) -> tuple[Contents, Damage | None]:
    """Check the whole file at `path`: data CRC, summary CRC, sizes.

    Returns:
        What the file holds in addition to its messages, as far as it could be read, and the first damage, if any.
    """
    contents, check = Contents([], {}, {}, {}, {}), _Checksums()
    try:
        with path.open("rb") as file:
            for record in _records(file, path.stat().st_size):
                check.update(record)
                with _damage_at(record.offset):
                    _note(record, contents)
        check.finish()
    except Damage as damage:
        return contents, _first_damage(path, damage)
    return contents, None


def _first_damage(path: Path, found: Damage) -> Damage:
    """Find the first damaged chunk; the CRC of the data section does not say where the damage is."""
    try:
        for _ in chunks(path, found.offset):
            pass
    except Damage as earlier:
        return earlier
    return found


def read_contents(path: Path) -> Contents:
    """Check the whole file at `path` and return what it holds in addition to its messages.

    Raises:
        Damage: with the first byte that must be wrong.
    """
    contents, damage = scan(path)
    if damage is not None:
        raise damage
    return contents


def read_head(path: Path) -> Contents:
    """Read the attachments and metadata before the first chunk; checks only these.

    Raises:
        Damage: if the file ends or a record is invalid before that.
    """
    contents = Contents([], {}, {}, {}, {})
    with path.open("rb") as file:
        for record in _records(file, path.stat().st_size):
            if record.opcode in {Opcode.CHUNK, Opcode.DATA_END}:
                break
            with _damage_at(record.offset):
                _note(record, contents)
    return contents


def _note(record: _Record, contents: Contents) -> None:
    stream = ReadDataStream(BytesIO(record.data))
    if record.opcode == Opcode.CHUNK:
        contents.chunks.append(ChunkPlace(record.offset, _UNPACKED.unpack_from(record.data)[0], {}))
    elif record.opcode == Opcode.MESSAGE:
        raise ValueError("a message outside the chunks, where no chunk's CRC covers it")
    elif record.opcode == Opcode.MESSAGE_INDEX:
        channel, length = struct.unpack_from("<HI", record.data)
        contents.chunks[-1].counts[channel] = length // 16
    elif record.opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        contents.schemas[schema.id] = (schema.name, schema.data.decode())
    elif record.opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        contents.channels[channel.id] = (channel.topic, channel.schema_id)
    elif record.opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream)
        if int.from_bytes(record.data[-4:], "little") != zlib.crc32(record.data[:-4]):
            raise ValueError(f"the CRC of the attachment {attachment.name!r} is wrong: bytes were changed")
        _add(contents.attachments, attachment.name, attachment.data)
        if sum(map(len, contents.attachments.values())) > MAX_CHUNK:
            raise ValueError(f"the attachments have more than {MAX_CHUNK} bytes; refused")
    elif record.opcode == Opcode.METADATA:
        entry = Metadata.read(stream)
        _add(contents.metadata, entry.name, entry.metadata)


def _add(known: dict[str, T], name: str, value: T) -> None:
    if name in known:
        raise ValueError(f"{name!r} is there twice")
    known[name] = value


@contextmanager
def _damage_at(offset: int) -> Iterator[None]:
    """Turn every error of a record's parser into a `Damage` at that record."""
    try:
        yield
    except (McapError, struct.error, ValueError, LookupError, OverflowError, zstandard.ZstdError) as error:
        what = f"{type(error).__name__}: {error}".removeprefix("ValueError: ")
        raise Damage(offset, f"the record that begins here is invalid ({what})") from None


class _Checksums:
    """CRC-32 of the data section up to DataEnd, then of the summary up to the CRC in the footer."""

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
            raise Damage(0, "the file has no checksums, so it cannot be trusted")


def read_chunk(path: Path, place: ChunkPlace, topics: dict[int, str]) -> Iterator[LogMessage]:
    """Messages of one chunk in the order of writing; channels found in the chunk are added to `topics`.

    Raises:
        Damage: if the chunk's size or CRC is wrong.
    """
    with path.open("rb") as file:
        file.seek(place.offset)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        for _, message in _messages(_Record(place.offset, opcode, file.read(length)), topics):
            yield message


def chunks(path: Path, end: int | None = None) -> Iterator[list[LogMessage]]:
    """Messages of each chunk from the beginning of a file, which may be damaged, up to the chunk at byte `end`.

    Raises:
        Damage: where the file is cut off, a chunk's size or CRC is wrong, or messages are missing before a chunk. They
            are missing if damage turned the opcode of the chunk before it into another.
    """
    topics: dict[int, str] = {}
    following: int | None = None
    with path.open("rb") as file:
        for record in _records(file, path.stat().st_size):
            if end is not None and record.offset >= end:
                return
            if record.opcode == Opcode.CHUNK:
                numbered = list(_messages(record, topics))
                if numbered and following not in {None, numbered[0][0]}:
                    raise Damage(record.offset, f"messages are missing before this byte, from number {following} on")
                following = numbered[-1][0] + 1 if numbered else following
                yield [message for _, message in numbered]


def first_number(path: Path) -> int:
    """Number of a file's first message; 0 if every chunk is damaged."""
    with suppress(Damage), path.open("rb") as file:
        for record in _records(file, path.stat().st_size):
            if record.opcode == Opcode.CHUNK:
                return next((number for number, _ in _messages(record, {})), 0)
    return 0


def whole_chunks(path: Path, end: int | None = None) -> Iterator[list[LogMessage]]:
    """Like `chunks`, but stops at the damage without an error: what a killed writer left."""
    with suppress(Damage):
        yield from chunks(path, end)


def _messages(record: _Record, topics: dict[int, str]) -> Iterator[tuple[int, LogMessage]]:
    """Messages of a chunk with their numbers, which continue from chunk to chunk."""
    with _damage_at(record.offset):
        raw = _unpack(record)
        offset = count = 0
        while offset < len(raw):
            opcode, length = _HEAD.unpack_from(raw, offset)
            start, offset = offset + _HEAD.size, offset + _HEAD.size + length
            count += 1
            if offset > len(raw):
                raise ValueError("a record in the chunk is longer than the chunk")
            if opcode not in _IN_CHUNKS or count > _MOST_RECORDS + len(raw) // _LEAST_BYTES:
                raise ValueError("the chunk holds records that no log holds, or far too many; refused")
            if opcode == Opcode.CHANNEL:
                named = Channel.read(ReadDataStream(BytesIO(raw[start:offset])))
                topics[named.id] = named.topic
            elif opcode == Opcode.MESSAGE:
                channel, number, time, _ = _MESSAGE.unpack_from(raw, start)
                yield number, LogMessage(topics[channel], time, raw[start + _MESSAGE.size : offset])


def _unpack(record: _Record) -> bytes:
    """Unpack a chunk and check its CRC; its size is checked before unpacking."""
    _unpacked_size(record)
    chunk = Chunk.read(ReadDataStream(BytesIO(record.data)))
    if chunk.compression != "zstd" or zstandard.frame_content_size(chunk.data) != chunk.uncompressed_size:
        raise Damage(record.offset, "a chunk is not packed as its header says")
    raw = zstandard.decompress(chunk.data)
    if zlib.crc32(raw) != chunk.uncompressed_crc:
        raise Damage(record.offset, "the CRC of a chunk is wrong: bytes were changed")
    return raw
