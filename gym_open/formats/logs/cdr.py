"""CDR, the byte encoding of ROS 2 messages, as far as logs need it: little-endian, values aligned to their size.

`mcap-ros2-support` does the same from the message definition, with one Python call per number. A step has about 430
numbers, so arrays go through NumPy here, which is ten times faster. The tests compare these bytes with that library's.
"""

import struct
from collections.abc import Sequence

import numpy as np

ENCAPSULATION = b"\x00\x01\x00\x00"
"""First bytes of a message: plain CDR, little-endian. Alignment counts from the byte after them."""
_SIZES = {"?": 1, "B": 1, "i": 4, "I": 4, "Q": 8, "d": 8}


class CdrWriter:
    """Appends values to a message; `data` is the message so far."""

    __slots__ = ("_buffer",)

    def __init__(self) -> None:
        self._buffer = bytearray(ENCAPSULATION)

    @property
    def data(self) -> bytes:
        """The encoded message."""
        return bytes(self._buffer)

    def align(self, size: int) -> None:
        """Pad to a multiple of `size` bytes, the alignment of a number of that size."""
        self._buffer.extend(bytes(-(len(self._buffer) - len(ENCAPSULATION)) % size))

    def scalar(self, code: str, value: float) -> None:
        """Append a number; `code` is its letter in the module `struct`."""
        self.align(_SIZES[code])
        self._buffer.extend(struct.pack(f"<{code}", value))

    def string(self, value: str) -> None:
        """Append a string: its length including the final zero byte, then its bytes."""
        raw = value.encode()
        self.scalar("I", len(raw) + 1)
        self._buffer.extend(raw)
        self._buffer.append(0)

    def strings(self, values: Sequence[str]) -> None:
        """Append a sequence of strings."""
        self.scalar("I", len(values))
        for value in values:
            self.string(value)

    def blob(self, value: bytes) -> None:
        """Append a `uint8[]`."""
        self.scalar("I", len(value))
        self._buffer.extend(value)

    def floats(self, values: np.ndarray) -> None:
        """Append a `float64[]`: `values` of any shape, flattened in C order."""
        self.scalar("I", values.size)
        if values.size:
            self.align(8)
            self._buffer.extend(np.ascontiguousarray(values, dtype="<f8").tobytes())

    def vector(self, values: Sequence[float]) -> None:
        """Append a `float64[n]` of fixed length: the numbers without a count."""
        self.align(8)
        self._buffer.extend(struct.pack(f"<{len(values)}d", *values))


class CdrReader:
    """Reads values from a message in the order in which they were appended.

    Raises:
        ValueError: from any method, if the message is too short.
    """

    __slots__ = ("_data", "_offset")

    def __init__(self, data: bytes) -> None:
        if data[:4] != ENCAPSULATION:
            raise ValueError(f"expected little-endian CDR (header {ENCAPSULATION.hex()}), got {data[:4].hex()}")
        self._data = data
        self._offset = len(ENCAPSULATION)

    def _take(self, count: int, align: int = 1) -> int:
        start = self._offset + (-(self._offset - len(ENCAPSULATION)) % align)
        if count > len(self._data) - start:
            raise ValueError(f"the message ends at byte {len(self._data)}, {count} more were expected at {start}")
        self._offset = start + count
        return start

    def scalar(self, code: str) -> int | float:
        """Read a number; `code` is its letter in the module `struct`."""
        size = _SIZES[code]
        return struct.unpack_from(f"<{code}", self._data, self._take(size, size))[0]

    def integer(self, code: str) -> int:
        """Read a number as an int."""
        return int(self.scalar(code))

    def string(self) -> str:
        """Read a string."""
        return self.blob()[:-1].decode()

    def strings(self) -> list[str]:
        """Read a sequence of strings."""
        return [self.string() for _ in range(self.integer("I"))]

    def blob(self) -> bytes:
        """Read a `uint8[]`."""
        count = self.integer("I")
        start = self._take(count)
        return self._data[start : start + count]

    def floats(self) -> np.ndarray:
        """Read a `float64[]`, flat."""
        count = self.integer("I")
        if not count:
            return np.empty(0)
        return np.frombuffer(self._data, "<f8", count, self._take(8 * count, 8)).astype(np.float64)

    def vector(self, count: int) -> tuple[float, ...]:
        """Read a `float64[count]` of fixed length."""
        return struct.unpack_from(f"<{count}d", self._data, self._take(8 * count, 8))
