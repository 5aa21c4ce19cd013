"""Images as video, in LeRobot's layout: one mp4 per data file, with its episodes one after the other.

Measured on 4,096 frames of exploration (CURL, 84×84, groups of 12 frames, preset medium); a PNG has 862 bytes:

    coding                    bytes per frame  PSNR        largest error     encoded and decoded, frames/s per core
    RGB, lossless (chosen)              303    no error                 0     4,300 and  8,300
    4:4:4, quantiser 0                  267    50.8 dB                  2     4,100 and  7,600
    4:2:0, CRF 10                       264    32.7 dB                130     4,500 and 13,700
    4:2:0, CRF 23                       134    32.1 dB                148     4,500 and 13,900

Objects are four pixels wide. Half the colour resolution, as in 4:2:0, costs more than all other losses, and saves
hardly any bytes over lossless coding. Browsers do not play RGB. LeRobot, PyAV and ffmpeg decode it exactly.
"""

import io
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gym_open.envs.constants import CONTROL_DT_S

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

MAX_FRAMES = 25_000
"""Frames per file. LeRobot finds a frame by its time in float32 to 0.1 ms; float32 is that fine up to 1,024 s."""
_GROUP = 12
"""Frames between two that are coded on their own. With 25 it is 214 bytes per frame, but random access is slower."""
_COMMON = {"preset": "medium", "g": str(_GROUP), "bf": "0"}
_FRAME = Fraction(CONTROL_DT_S).limit_denominator(10**6)
"""Duration of a frame in seconds, the unit of all times here."""


class Coding(NamedTuple):
    """How images become video."""

    encoder: str
    pixels: str
    """FFmpeg's name of the pixel format."""
    options: dict[str, str]
    scale: int = 1
    """Width and height of a square that shows one pixel."""


EXACT = Coding("libx264rgb", "rgb24", {**_COMMON, "qp": "0"})
"""Lossless."""
BROWSER = Coding("libx264", "yuv420p", {**_COMMON, "crf": "12"}, scale=2)
"""What browsers play. 4:2:0 stores one colour for four pixels; at double size, that is one for each image pixel."""


def enlarged(image: np.ndarray, scale: int) -> np.ndarray:
    """The image (H, W, 3) with every pixel as a square of `scale` pixels."""
    return image if scale == 1 else image.repeat(scale, axis=0).repeat(scale, axis=1)


def encode_clip(images: np.ndarray, coding: Coding = EXACT) -> bytes:
    """Encode images (n, H, W, 3) uint8 RGB as an mp4 that can be appended to others. Equal images give equal bytes."""
    import av
    from av.video.stream import VideoStream

    out = io.BytesIO()
    with av.open(out, "w", format="mp4") as container:
        stream = container.add_stream(coding.encoder, rate=1 / _FRAME, options=coding.options)
        assert isinstance(stream, VideoStream)
        stream.height, stream.width = (coding.scale * size for size in images.shape[1:3])
        stream.pix_fmt, stream.time_base, stream.thread_count = coding.pixels, _FRAME, 1
        for number, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(enlarged(image, coding.scale), format="rgb24")
            frame.pts, frame.time_base = number, _FRAME
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return out.getvalue()


def decode_clip(data: bytes) -> np.ndarray:
    """Decode all images of an mp4: (n, H, W, 3) uint8 RGB."""
    import av
    from av.container import InputContainer

    with av.open(io.BytesIO(data), format="mp4") as container:
        assert isinstance(container, InputContainer)
        container.streams.video[0].thread_count = 1
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def pixel_error(logged: np.ndarray, decoded: np.ndarray) -> dict[str, float]:
    """Mean and largest absolute difference, and mean square difference, in levels of 255; `decoded` may be larger."""
    mean = largest = square = 0.0
    scale = decoded.shape[1] // logged.shape[1]
    for a, b in zip(logged, decoded, strict=True):  # one image at a time, to save memory
        error = np.abs(enlarged(a, scale).astype(np.int16) - b)
        mean += float(error.mean())
        largest = max(largest, float(error.max()))
        square += float(np.square(error, dtype=np.int64).mean())
    return {"mean": mean / len(logged), "max": largest, "mse": square / len(logged)}


class VideoFile:
    """An mp4 that grows by clips, which are not encoded again."""

    def __init__(self, path: Path) -> None:
        import av

        path.parent.mkdir(parents=True, exist_ok=True)
        self.frames = 0
        self._container: OutputContainer = av.open(str(path), "w", format="mp4")
        self._stream: VideoStream | None = None

    def add(self, clip: bytes) -> None:
        """Append a clip from `encode_clip`."""
        import av
        from av.container import InputContainer

        with av.open(io.BytesIO(clip), format="mp4") as source:
            assert isinstance(source, InputContainer)
            (video,) = source.streams.video
            if self._stream is None:
                self._stream = self._container.add_stream_from_template(video, opaque=True)
                self._stream.time_base = _FRAME
            for packet in source.demux(video):
                if packet.size:  # the last one is empty
                    packet.pts = packet.dts = self.frames  # no frame refers to a later one: they keep their order
                    packet.duration, packet.time_base, packet.stream = 1, _FRAME, self._stream
                    self._container.mux(packet)
                    self.frames += 1

    def close(self) -> None:
        """Write the index, without which an mp4 is unreadable."""
        self._container.close()
