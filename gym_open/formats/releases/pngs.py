"""PNG files of releases: looked at before they are decoded."""

import struct

import numpy as np

from gym_open.envs.constants import IMAGE_SIZE
from gym_open.formats.pictures import decode_png

MAX_BYTES = 4 * 3 * IMAGE_SIZE**2
"""Four times the raw picture: no PNG file of ours is larger."""
_HEADER = struct.Struct(">8sI4sII5B")
_EXPECTED = (b"\x89PNG\r\n\x1a\n", 13, b"IHDR", IMAGE_SIZE, IMAGE_SIZE, 8, 2, 0, 0, 0)
"""Signature, the header's length and name, width, height; 8 bits of RGB, compressed, filtered, not interlaced."""


def decode(data: bytes) -> np.ndarray:
    """The picture in a PNG file of a release: (84, 84, 3) uint8 RGB.

    Raises:
        ValueError: if it is too large, of another size or kind, or damaged.
    """
    if len(data) > MAX_BYTES or len(data) < _HEADER.size or _HEADER.unpack_from(data) != _EXPECTED:
        raise ValueError(f"no PNG file of {IMAGE_SIZE}×{IMAGE_SIZE} RGB pixels of at most {MAX_BYTES:,} bytes")
    try:
        return decode_png(data)
    except (OSError, SyntaxError, ValueError) as error:
        raise ValueError(f"a damaged PNG file: {error}") from None
