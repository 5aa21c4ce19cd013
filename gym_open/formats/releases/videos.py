"""Images of releases that store them as video: decoded frames of an mp4 by number."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gym_open.envs.constants import IMAGE_SIZE
from gym_open.errors import ArtefactError

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

CODEC = "h264"
_PIXELS = "gbrp"
"""RGB, coded without loss."""
_REMEDY = "it is damaged or not from gym-open; get the release again"


def decode(path: Path, first: int, stop: int) -> Iterator[np.ndarray]:
    """Decode the frames from `first` to `stop` (exclusive) of the video at `path`, each (84, 84, 3) uint8 RGB.

    Raises:
        ArtefactError: if the video is missing, not H.264 of our size, cannot be decoded, or has fewer frames.
    """
    due = first
    with _opened(path) as container:
        stream = _stream(path, container)
        unit, rate = stream.time_base, stream.average_rate
        assert unit is not None
        assert rate is not None
        if first:
            container.seek(round(first / rate / unit), stream=stream)
        for frame in container.decode(stream):
            number = -1 if frame.pts is None else round(frame.pts * unit * rate)
            if number < due:
                continue
            if number != due or (frame.width, frame.height) != (IMAGE_SIZE, IMAGE_SIZE):
                raise ArtefactError(f"{path}: expected frame {due} of {IMAGE_SIZE} pixels, got {number}; {_REMEDY}")
            yield frame.to_ndarray(format="rgb24")
            due += 1
            if due >= stop:
                return
    raise ArtefactError(f"{path}: ends after frame {due}, expected {stop}; {_REMEDY}")


def n_frames(path: Path) -> int:
    """Number of frames that the video at `path` claims to have.

    Raises:
        ArtefactError: if the video is missing, or not H.264 of our size.
    """
    with _opened(path) as container:
        return _stream(path, container).frames


@contextmanager
def _opened(path: Path) -> "Iterator[InputContainer]":
    import av
    from av.container import InputContainer
    from av.error import FFmpegError

    if path.is_symlink() or not path.is_file():
        raise ArtefactError(f"{path}: missing, or a link; {_REMEDY}")
    try:
        # A file object instead of a name: a container that refers to other files cannot open them.
        with path.open("rb") as file, av.open(file, format="mp4") as container:
            assert isinstance(container, InputContainer)
            yield container
    except (FFmpegError, OSError, ValueError, MemoryError) as error:
        raise ArtefactError(f"{path}: cannot be decoded: {error}; {_REMEDY}") from None


def _stream(path: Path, container: "InputContainer") -> "VideoStream":
    """The only stream of a container; its size is checked before anything is decoded."""
    if len(container.streams) != 1 or len(container.streams.video) != 1:
        raise ArtefactError(f"{path}: expected one stream, of video, got {len(container.streams)}; {_REMEDY}")
    (stream,) = container.streams.video
    context = stream.codec_context
    found = (context.name, context.width, context.height, context.pix_fmt)
    if found != (CODEC, IMAGE_SIZE, IMAGE_SIZE, _PIXELS) or not stream.average_rate or not stream.time_base:
        raise ArtefactError(
            f"{path}: expected {CODEC} of {IMAGE_SIZE}×{IMAGE_SIZE} pixels ({_PIXELS}), got {context.name} of "
            f"{context.width}×{context.height} ({context.pix_fmt}); {_REMEDY}"
        )
    context.thread_count = 1
    return stream
