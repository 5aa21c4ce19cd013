"""Parquet files of releases, opened as what they are until they are verified: anybody's.

A few bytes can claim to be a lot: a footer of any length, rows without number, a dictionary with one long word that
every row repeats, runs of a billion nulls. So the footer's length is looked at before it is parsed, and the header of
every page before the page is unpacked. Allowed is what our writer makes: plain values, Snappy or no compression. Snappy
gives at most 64 bytes for 3, plain values have their size, so memory is bounded by the size of the file.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from gym_open.errors import ArtefactError

if TYPE_CHECKING:  # heavy, and needed only when something is read
    import pyarrow as pa
    import pyarrow.parquet as pq

MAX_FOOTER_BYTES = 2**24
"""A file of 2 GiB of our frames has a footer of some 2 MB."""
MAX_GROUP_BYTES = 2**31
"""Most that a row group may unpack to."""
_MAGIC = b"PAR1"
_CODECS = ("SNAPPY", "UNCOMPRESSED")
_SNAPPY_RATIO = 22
_PLAIN, _RLE = 0, 3
_DATA_PAGES = (0, 3)
"""Types of page: data (version 1 and 2). An index has 1, a dictionary 2."""
_HEADER_BYTES = 2**16
"""A page's header has some 50 bytes, and its least and greatest value if they are short."""
_REMEDY = "it is damaged or not of gym-open; get the release anew"


class ParquetError(ArtefactError):
    """A parquet file is damaged, or is not as our writer makes it."""


def metadata(path: Path) -> "pq.FileMetaData":
    """The footer of the file at `path`, if its length, its counts and its places can be.

    Raises:
        ParquetError: if the file is missing, no parquet, or its footer cannot be that of our writer.
    """
    with opened(path) as file:
        return file.metadata


def read(
    path: Path, schema: "pa.Schema | None", columns: Sequence[str] | None = None, groups: Sequence[int] | None = None
) -> "pa.Table":
    """Columns and row groups (all, if not given) of the file at `path`, in the order of the schema.

    Args:
        path: of the file.
        schema: the columns that the file must have, in whatever order; None for those that it has.
        columns: names; a part of a struct as `name.part`.
        groups: numbers of row groups.

    Raises:
        ParquetError: if the file is missing, damaged, of another schema, or would unpack to what it cannot hold.
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
        raise ParquetError(f"{path}: {len(table)} rows where its footer tells of others; {_REMEDY}")
    return table.select([name for name in expected.names if name in table.column_names])


def opened(path: Path) -> "pq.ParquetFile":
    """The file at `path`, its footer checked; its pages are not yet (`check_pages`).

    Raises:
        ParquetError: as `metadata` does.
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
    """Raises ParquetError if a count or a place in a footer cannot be right; pages end before the byte `end`."""
    rows = [found.row_group(number).num_rows for number in range(found.num_row_groups)]
    if min(rows, default=0) < 0 or sum(rows) != found.num_rows or not 0 <= found.num_rows <= size:
        raise ParquetError(f"{path}: {found.num_rows:,} rows in {size:,} bytes and {len(rows)} groups; {_REMEDY}")
    for number in range(found.num_row_groups):
        group, total = found.row_group(number), 0
        for place in range(group.num_columns if group.num_rows else 0):  # one without rows is never read
            chunk = group.column(place)
            total += chunk.total_uncompressed_size
            start, length = chunk.data_page_offset, chunk.total_compressed_size
            if chunk.file_path or chunk.has_dictionary_page or chunk.compression not in _CODECS:
                raise ParquetError(
                    f"{path}: column {chunk.path_in_schema!r} has a dictionary, lies in another file or is compressed "
                    f"with {chunk.compression}; {_REMEDY}"
                )
            if not (start >= 4 and length >= 0 and start + length <= end and chunk.total_uncompressed_size >= 0):
                raise ParquetError(f"{path}: column {chunk.path_in_schema!r} lies outside of the file; {_REMEDY}")
        if total > MAX_GROUP_BYTES:
            raise ParquetError(
                f"{path}: row group {number} says that it unpacks to {total:,} bytes, at most {MAX_GROUP_BYTES:,} are "
                f"allowed; {_REMEDY}"
            )


def check_pages(
    path: Path, found: "pq.FileMetaData", columns: Sequence[str] | None = None, groups: Sequence[int] | None = None
) -> None:
    """Look at the header of every page of some columns and row groups (all, if not given) before they are unpacked.

    Raises:
        ParquetError: if a page is not as our writer makes it, or its size or number of values cannot be right.
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
    """Whether a path is one of the names or a part of one; names may have dots in them, too."""
    while path and path not in names:
        path = path.rpartition(".")[0]
    return bool(path)


def _check_chunk(file: BinaryIO, chunk: Any, rows: int) -> None:
    """Raises ValueError or IndexError if the pages of a column chunk cannot be those of our writer."""
    values = unpacked = 0
    for header, length, packed, size in _pages(file, chunk.data_page_offset, chunk.total_compressed_size):
        about = header.get(5) or header.get(8)
        if header.get(1) not in _DATA_PAGES or not isinstance(about, dict):
            raise ValueError(f"a page of type {header.get(1)}, expected data")
        encoding = about.get(2 if header[1] == 0 else 4)
        if encoding != _PLAIN and not (encoding == _RLE and chunk.physical_type == "BOOLEAN"):
            raise ValueError(f"values of encoding {encoding}, expected plain ones")
        if not 0 <= size <= packed * _SNAPPY_RATIO + 64:
            raise ValueError(f"a page of {packed:,} bytes that says that it unpacks to {size:,}")
        values += about.get(1, -1)
        unpacked += length + size
    if values != chunk.num_values or not rows <= values <= max(rows, 8 * unpacked):
        raise ValueError(
            f"{values:,} values in {rows:,} rows and {unpacked:,} bytes, its footer says {chunk.num_values:,}"
        )
    if unpacked != chunk.total_uncompressed_size:
        raise ValueError(f"unpacks to {unpacked:,} bytes, its footer says {chunk.total_uncompressed_size:,}")


def _pages(file: BinaryIO, start: int, length: int) -> Iterator[tuple[dict[int, Any], int, int, int]]:
    """Each page's header, the header's length, and the page's size as it is and unpacked."""
    at, end = start, start + length
    while at < end:
        file.seek(at)
        buffer = _Compact(file.read(min(_HEADER_BYTES, end - at)))
        header = buffer.struct()
        size, packed = header.get(2), header.get(3)
        if not (isinstance(size, int) and isinstance(packed, int) and 0 <= packed <= end - at - buffer.at):
            raise ValueError(f"a page of {packed} bytes reaches over its end")
        yield header, buffer.at, packed, size
        at += buffer.at + packed


class _Compact:
    """Thrift's compact protocol, as far as the headers of pages need it. Raises IndexError at its end."""

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
    """What is wrong with the columns of a file, if anything."""
    if odd := sorted(set(found.names) ^ set(expected.names)) or len(found.names) > len(expected.names):
        named = ", ".join(repr(name[:100]) for name in odd[:5]) if isinstance(odd, list) else "one is there twice"
        return f"its columns are not those of this release: {named}"
    for name in expected.names:
        if not (one := found.field(name)).type.equals(expected.field(name).type):
            return f"column {name!r} should be {expected.field(name).type}, got {str(one.type)[:200]}"
    return None
