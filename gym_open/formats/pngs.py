"""Images as PNG files: lossless, and the same bytes for the same version of PyAV, which brings its own zlib."""

import io
import struct
from fractions import Fraction

import numpy as np

from gym_open.envs.constants import IMAGE_SIZE

PNG_LEVEL = 6
"""Compression level, used without a filter: 7,200 frames/s per core and 860 bytes per frame. With Pillow's choice of
filters, it is 3,800 frames/s and 1,250 bytes. Level 9 saves 1% of the bytes at a quarter of the speed."""
MAX_BYTES = 4 * 3 * IMAGE_SIZE**2
"""Four times the raw image: no PNG file of ours is larger."""
_HEADER = struct.Struct(">8sI4sII5B")
_EXPECTED = (b"\x89PNG\r\n\x1a\n", 13, b"IHDR", IMAGE_SIZE, IMAGE_SIZE, 8, 2, 0, 0, 0)
"""Signature, the header's length and name, width, height; 8 bits of RGB, compressed, filtered, not interlaced."""


def encode_pngs(images: np.ndarray) -> list[bytes]:
    """PNG files of (n, H, W, 3) uint8 RGB images, in their order. It releases the GIL."""
    import av

    coder = av.CodecContext.create("png", "w")
    assert isinstance(coder, av.VideoCodecContext)
    coder.height, coder.width = images.shape[1:3]
    coder.pix_fmt, coder.time_base, coder.thread_count = "rgb24", Fraction(1, 25), 1
    coder.options = {"pred": "none", "compression_level": str(PNG_LEVEL)}
    frames = (av.VideoFrame.from_ndarray(image, format="rgb24") for image in images)
    return [bytes(packet) for frame in frames for packet in coder.encode(frame)]


def decode_png(data: bytes) -> np.ndarray:
    """The image in a PNG file's bytes: (H, W, 3) uint8 RGB."""
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))


def decode_untrusted(data: bytes) -> np.ndarray:
    """The observation in a PNG file that anybody may have written, such as a release's: (84, 84, 3) uint8 RGB.

    Raises:
        ValueError: if the file is too large, of another size or kind, or damaged.
    """
    if len(data) > MAX_BYTES or len(data) < _HEADER.size or _HEADER.unpack_from(data) != _EXPECTED:
        raise ValueError(f"no PNG file of {IMAGE_SIZE}×{IMAGE_SIZE} RGB pixels of at most {MAX_BYTES:,} bytes")
    try:
        return decode_png(data)
    except (OSError, SyntaxError, ValueError) as error:
        raise ValueError(f"a damaged PNG file: {error}") from None
