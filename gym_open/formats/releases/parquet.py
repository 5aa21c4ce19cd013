"""Safe reader of the parquet files of releases, which are untrusted until they are verified.

A few bytes can claim to be large: a footer of any length, any number of rows, a dictionary with one long word that
every row repeats, runs of a billion nulls. Therefore this module checks the footer's length before it parses the
footer, and the header of every page before it unpacks the page. It allows only what our writer makes: plain values,
with Snappy or without compression. Snappy makes at most 64 bytes from 3, and plain values have a fixed size. So the
size of the file bounds the memory.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from gym_open.errors import ArtefactError

if TYPE_CHECKING:  # heavy, and needed only when something is read
    import pyarrow as pa
    import pyarrow.parquet as pq

MAX_FOOTER_BYTES = 2**24
"""A file of 2 GiB of our frames has a footer of about 2 MB."""
MAX_GROUP_BYTES = 2**31
"""Greatest unpacked size of a row group."""
_MAGIC = b"PAR1"
_CODECS = ("SNAPPY", "UNCOMPRESSED")
_SNAPPY_RATIO = 22
_PLAIN, _RLE = 0, 3
_DATA_PAGES = (0, 3)
"""Types of data pages, versions 1 and 2. An index page has type 1, a dictionary page 2."""
_HEADER_BYTES = 2**16
"""Bytes read for a page's header. It has about 50 bytes, plus the least and greatest value if they are short."""
_REMEDY = "it is damaged or not from gym-open; get the release again"


class ParquetError(ArtefactError):
    """A parquet file is damaged, or our writer cannot have made it."""


def metadata(path: Path) -> "pq.FileMetaData":
    """Read the footer of the file at `path` and check its length, counts and offsets.

    Raises:
        ParquetError: if the file is missing or not parquet, or our writer cannot have made its footer.
    """
    with opened(path) as file:
        return file.metadata


def read(
    path: Path, schema: "pa.Schema | None", columns: Sequence[str] | None = None, groups: Sequence[int] | None = None
) -> "pa.Table":
    """Read columns and row groups (default all) of the file at `path`, in the order of the schema.

    Args:
        path: of the file.
        schema: the columns that the file must have, in any order; None accepts any columns.
        columns: names of columns; `name.part` for a part of a struct.
        groups: numbers of row groups.

    Raises:
        ParquetError: if the file is missing, damaged, of another schema, or would unpack to more than it can hold.
    """
    import pyarrow as pa

    with opened(path) as file:
        expected: pa.Schema = file.schema_arrow if schema is None else schema
        if wrong := _difference(file.schema_arrow, expected):
            raise ParquetError(f"{path}: {wrong}; {_REMEDY}")
        rows = [file.metadata.row_group(group).num_rows for group in range(file.metadata.num_row_groups)]
        chosen = [group for group in (range(len(rows)) if groups is None else groups) if rows[group]]
        check_pages(path, file.metadata, columns, chosen)
        try:
            table = file.read_row_groups(chosen, columns=None if columns is None else list(columns))
            table.validate(full=True)
        except (pa.ArrowException, OSError) as error:
            raise ParquetError(f"{path}: cannot be unpacked: {error}; {_REMEDY}") from None
    if len(table) != sum(rows[group] for group in chosen):
        raise ParquetError(f"{path}: {len(table)} rows, which is not the number in its footer; {_REMEDY}")
    return table.select([name for name in expected.names if name in table.column_names])


def opened(path: Path) -> "pq.ParquetFile":
    """Open the file at `path` and check its footer; `check_pages` checks its pages.

    Raises:
        ParquetError: see `metadata`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    size = footer = 0
    try:
        if path.is_symlink() or not path.is_file():
            raise ParquetError(f"{path}: missing, or a link; {_REMEDY}")
        size = path.stat().st_size
        with path.open("rb") as raw:
            raw.seek(max(size - 8, 0))
            tail = raw.read(8)
        footer = int.from_bytes(tail[:4], "little")
        if len(tail) < 8 or tail[4:] != _MAGIC or footer > min(size - 12, MAX_FOOTER_BYTES):
            raise ParquetError(
                f"{path}: {size:,} bytes with a footer of {footer:,}, at most {MAX_FOOTER_BYTES:,} are allowed; "
                f"{_REMEDY}"
            )
        file = pq.ParquetFile(
            path, thrift_string_size_limit=MAX_FOOTER_BYTES, thrift_container_size_limit=MAX_FOOTER_BYTES
        )
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ParquetError(f"{path}: not readable as parquet: {error}; {_REMEDY}") from None
    try:
        _check_footer(path, file.metadata, size, size - 8 - footer)
    except ParquetError:
        file.close()
        raise
    return file


def _check_footer(path: Path, found: "pq.FileMetaData", size: int, end: int) -> None:
    """Raises ParquetError if a count or offset in a footer is impossible; pages end before the byte `end`."""
    rows = [found.row_group(number).num_rows for number in range(found.num_row_groups)]
    if min(rows, default=0) < 0 or sum(rows) != found.num_rows or not 0 <= found.num_rows <= size:
        raise ParquetError(f"{path}: {found.num_rows:,} rows in {size:,} bytes and {len(rows)} groups; {_REMEDY}")
    for number in range(found.num_row_groups):
        group, total = found.row_group(number), 0
        for place in range(group.num_columns if group.num_rows else 0):  # a group without rows is never read
            chunk = group.column(place)
            total += chunk.total_uncompressed_size
            start, length = chunk.data_page_offset, chunk.total_compressed_size
            if chunk.file_path or chunk.has_dictionary_page or chunk.compression not in _CODECS:
                raise ParquetError(
                    f"{path}: column {chunk.path_in_schema!r} has a dictionary, is in another file or is compressed "
                    f"with {chunk.compression}; {_REMEDY}"
                )
            if not (start >= 4 and length >= 0 and start + length <= end and chunk.total_uncompressed_size >= 0):
                raise ParquetError(f"{path}: column {chunk.path_in_schema!r} lies outside the file; {_REMEDY}")
        if total > MAX_GROUP_BYTES:
            raise ParquetError(
                f"{path}: row group {number} claims to unpack to {total:,} bytes, at most {MAX_GROUP_BYTES:,} are "
                f"allowed; {_REMEDY}"
            )


def check_pages(
    path: Path, found: "pq.FileMetaData", columns: Sequence[str] | None = None, groups: Sequence[int] | None = None
) -> None:
    """Check the header of every page of some columns and row groups (default all) before they are unpacked.

    Raises:
        ParquetError: if our writer cannot have made a page, or its size or number of values is impossible.
    """
    wanted = None if columns is None else set(columns)
    with path.open("rb") as file:
        for number in range(found.num_row_groups) if groups is None else groups:
            group = found.row_group(number)
            for place in range(group.num_columns):
                chunk = group.column(place)
                if wanted is None or _within(chunk.path_in_schema, wanted):
                    try:
                        _check_chunk(file, chunk, group.num_rows)
                    except (ValueError, IndexError) as error:
                        raise ParquetError(
                            f"{path}: row group {number}, column {chunk.path_in_schema!r}: {error}; {_REMEDY}"
                        ) from None


def _within(path: str, names: set[str]) -> bool:
    """Whether a path is one of the names or a part of one of them; names may contain dots."""
    while path and path not in names:
        path = path.rpartition(".")[0]
    return bool(path)


def _check_chunk(file: BinaryIO, chunk: Any, rows: int) -> None:
    """Raises ValueError or IndexError if our writer cannot have made the pages of a column chunk."""
    values = unpacked = 0
    for header, length, packed, size in _pages(file, chunk.data_page_offset, chunk.total_compressed_size):
        about = header.get(5) or header.get(8)
        if header.get(1) not in _DATA_PAGES or not isinstance(about, dict):
            raise ValueError(f"a page of type {header.get(1)}, expected data")
        encoding = about.get(2 if header[1] == 0 else 4)
        if encoding != _PLAIN and not (encoding == _RLE and chunk.physical_type == "BOOLEAN"):
            raise ValueError(f"values of encoding {encoding}, expected plain ones")
        if not 0 <= size <= packed * _SNAPPY_RATIO + 64:
            raise ValueError(f"a page of {packed:,} bytes that claims to unpack to {size:,}")
        values += about.get(1, -1)
        unpacked += length + size
    if values != chunk.num_values or not rows <= values <= max(rows, 8 * unpacked):
        raise ValueError(
            f"{values:,} values in {rows:,} rows and {unpacked:,} bytes, its footer says {chunk.num_values:,}"
        )
    if unpacked != chunk.total_uncompressed_size:
        raise ValueError(f"unpacks to {unpacked:,} bytes, its footer says {chunk.total_uncompressed_size:,}")


def _pages(file: BinaryIO, start: int, length: int) -> Iterator[tuple[dict[int, Any], int, int, int]]:
    """For each page: its header, the header's length, and the page's packed and unpacked size."""
    at, end = start, start + length
    while at < end:
        file.seek(at)
        buffer = _ThriftReader(file.read(min(_HEADER_BYTES, end - at)))
        header = buffer.struct()
        size, packed = header.get(2), header.get(3)
        if not (isinstance(size, int) and isinstance(packed, int) and 0 <= packed <= end - at - buffer.at):
            raise ValueError(f"a page of {packed} bytes reaches past the end")
        yield header, buffer.at, packed, size
        at += buffer.at + packed


class _ThriftReader:
    """Thrift's compact protocol, as far as the headers of pages need it. Raises IndexError at the end of the data."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """The fields of a struct, by number."""
        if depth > 4:
            raise ValueError("a page's header is nested too deeply")
        fields: dict[int, Any] = {}
        number = 0
        while kind := self._byte():
            step, kind = kind >> 4, kind & 15
            number = number + step if step else self._zigzag()
            fields[number] = self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (1, 2):
            return kind == 1
        if kind == 3:
            return self._byte()
        if kind in (4, 5, 6):
            return self._zigzag()
        if kind == 8:
            length = self._varint()
            self.at += length
            return None
        if kind == 12:
            return self.struct(depth + 1)
        raise ValueError(f"a page's header with a field of type {kind}")

    def _byte(self) -> int:
        self.at += 1
        return self._data[self.at - 1]

    def _varint(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7
            if shift > 63:
                raise ValueError("a page's header with a number of more than 64 bits")

    def _zigzag(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)


def _difference(found: "pa.Schema", expected: "pa.Schema") -> str | None:
    """How the columns of a file differ from the expected ones; None if they do not."""
    if odd := sorted(set(found.names) ^ set(expected.names)) or len(found.names) > len(expected.names):
        named = ", ".join(repr(name[:100]) for name in odd[:5]) if isinstance(odd, list) else "a column is there twice"
        return f"its columns are not those of this release: {named}"
    for name in expected.names:
        if not (one := found.field(name)).type.equals(expected.field(name).type):
            return f"column {name!r} should be {expected.field(name).type}, got {str(one.type)[:200]}"
    return None
